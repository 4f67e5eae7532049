"""A measured U that has noise, of which the spool knows nothing."""

from dataclasses import fields

import numpy as np
import pytest

from benchmarks import circumstances as c
from benchmarks.one_model_rows import behind
from model.test_flow_held import BOTH, after, rows_of
from valvemap.model import flow_causes, flow_evidence
from valvemap.model.flow_map import FlowMap
from valvemap.model.flow_rivals import Rivals, none
from valvemap.model.kernels import flow_between as between
from valvemap.model.kernels import flow_evidence as kernel
from valvemap.model.kernels import flow_path as paths

VALVE = c.VALVES["ordinary"]
NOISE = 0.25


def noisy(U, seed, step=0.0):
    U = U + NOISE * np.random.default_rng([seed, 99]).standard_normal(len(U))
    return np.round(U / step) * step if step else U


def calmed(x, noise, gap_at=None):
    rows = rows_of(np.array(x, float), *np.zeros((2, len(x))))
    if gap_at is not None:
        rows[gap_at, paths.STEP] = 60.0
    given, out = np.zeros(paths.PARAMETERS), rows.copy()
    given[paths.NOISE_U] = noise
    kernel.as_they_were(rows, given, out)
    return out[:, paths.LEFT_U]


def test_noise_is_averaged_out_and_what_moves_is_kept():
    t = np.arange(400.0)
    for U in (np.full(400, 30.0), 20.0 + 0.1 * t, np.clip(2.0 * (t - 200.0), 0.0, 80.0)):
        left = calmed(noisy(U, 3), NOISE) - U
        assert np.std(left[20:190]) < 0.35 * NOISE
        assert np.abs(left).max() < 4.0 * NOISE
        assert abs(np.mean(left)) < 0.1 * NOISE
        np.testing.assert_allclose(calmed(U, NOISE)[9:191], U[9:191], atol=1e-9)


def test_what_was_before_an_interruption_is_not_averaged():
    U = np.repeat([10.0, 10.2], 20)
    np.testing.assert_array_equal(calmed(U, NOISE, gap_at=20), U)


def test_a_step_is_no_noise():
    U = np.repeat([10.0, 60.0, 20.0], 20)
    np.testing.assert_array_equal(calmed(U, NOISE), U)


@pytest.mark.parametrize("step", [0.0, 0.3])
def test_the_noise_is_judged_where_U_is_calm(step):
    U, _ = c.cycle(4, 1280)
    assert flow_evidence.noise_where_calm(U) == 0.0
    assert flow_evidence.noise_where_calm(noisy(U, 4, step)) == pytest.approx(NOISE, rel=0.35)


def test_the_steps_of_a_command_that_holds_each_value_are_no_noise():
    U = np.repeat(50.0 + 40.0 * np.abs(np.arange(640) % 100 - 50.0) / 50.0, 2)
    assert flow_evidence.noise_where_calm(U) < 1e-6
    assert flow_evidence.noise_where_calm(np.repeat(noisy(U[::2], 4), 2)) == pytest.approx(
        NOISE, rel=0.35
    )


def searched(shown, actual, dp, seed):
    Q = VALVE(actual, dp) + c.white(seed, len(dp))
    evidence = flow_evidence.Evidence(*BOTH, rows_of(shown, dp, Q))
    start = np.zeros(paths.PARAMETERS)
    at, _ = flow_causes.search(evidence, start, Rivals(none(), start))
    return {int(k): float(at[k]) for k in np.flatnonzero(at)}


@pytest.mark.parametrize("seed", [11, 12])
def test_noise_of_U_is_no_friction_and_no_play(seed):
    U, dp = c.cycle(seed, 1280)
    assert set(searched(noisy(U, seed), U, dp, seed)) <= {paths.NOISE_U}
    assert searched(U, U, dp, seed) == {}


def test_play_is_found_beside_noise_of_U():
    U, dp = c.cycle(13, 1280)
    found = searched(noisy(U, 13), behind(U, 3.0), dp, 13)
    assert found[paths.PLAY] == pytest.approx(1.5, abs=0.3)


def test_the_map_behind_a_noisy_U_is_that_of_the_valve_however_samples_are_cut():
    U, dp = c.cycle(7, 4_000)
    samples = c.samples_of(noisy(U, 7), dp, VALVE(U, dp) + c.white(7, 4_000))
    whole, trace = after(FlowMap().initial_state(), samples)
    near = c.inside(U, dp)
    Q, std = FlowMap().predict(whole, near.U, near.dp, np.full(len(near.U), 40.0))
    off = Q - VALVE(near.U, near.dp)
    assert np.sqrt(np.mean(off**2)) < 0.8 * c.SIGMA
    assert np.mean(np.abs(off) <= 1.96 * std) > 0.9
    assert FlowMap().findings(whole) == ()
    assert whole.path[paths.NOISE_U] == pytest.approx(NOISE, rel=0.35)
    assert np.isfinite(trace.predicted[200:]).all()
    pieces, _ = after(FlowMap().initial_state(), samples, cuts=(1, 7, 1_500, 1_504, 2_900))
    for field in fields(whole):
        np.testing.assert_array_equal(getattr(pieces, field.name), getattr(whole, field.name))


@pytest.mark.parametrize("size", [1, 2, 3, 11, 40, 1278])
def test_the_tenth_quantile_is_numpys(size):
    rng = np.random.default_rng(size)
    for x in (rng.normal(size=size), rng.integers(0, 4, size).astype(float), np.zeros(size)):
        assert between.tenth.py_func(x.copy()) == pytest.approx(np.quantile(x, 0.1), abs=1e-12)
