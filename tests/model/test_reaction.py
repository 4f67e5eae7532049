"""U that reacts to the noise of the same sample is told from all else, and said."""

from functools import partial

import numpy as np
import pytest

from benchmarks import circumstances as c
from support.missed import missed
from valvemap.model.flow_map import FlowMap
from valvemap.model.forgetting import Adaptive
from valvemap.model.kernels import reaction
from valvemap.model.maximum_likelihood import MaximumLikelihood
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.vocabulary.statuses import Adaptation

N = 6_000
ESTIMATORS = {
    "RLS": RecursiveLeastSquares(forgetting=Adaptive()),
    "RML": MaximumLikelihood(lam=0.999),
    "Auto": FlowMap(),
}


def says(estimator, U, dp, Q):
    state, _ = estimator.update(estimator.initial_state(), c.samples_of(U, dp, Q))
    said = estimator.adaptation(state)
    of_many = estimator.adaptation_many(
        type(state)(*(np.asarray(x)[None] for x in vars(state).values()))
    )
    assert of_many.tolist() == [said]
    return said, state


@pytest.mark.parametrize(
    ("name", "noise"),
    [
        *((name, noise) for noise in (c.white, c.ar) for name in ("RLS", "RML")),
        ("Auto", c.white),
        pytest.param("Auto", c.ar, marks=missed("in noise of AR(.95)")),
    ],
)
def test_U_that_reacts_is_said_to(name, noise):
    (U, dp), e = c.cycle(70, N), noise(70, N)
    U = c.reacting(U, e, gain=0.8)
    said, state = says(ESTIMATORS[name], U, dp, c.ordinary(U, dp) + e)
    assert said == Adaptation.REACTING
    if name == "Auto":  # smoothed by a lag its jitter would seem to explain the flow better
        assert ESTIMATORS[name].lags(state) == (0.0, 0.0)


def scattered(valve, held=1, tau=0.0):
    """It may react, but next to what else moves U that is nothing."""
    (U, dp), e = (np.repeat(x, held) for x in c.scattered(71, N // held)), c.white(71, N)
    U = c.reacting(U, e) if held == 1 else U
    return U, dp, c.lagged(valve(U, dp), tau) + e


def cycle(valve, tau_U=0.0, tau_Q=0.0, noise=c.white, step=0.0):
    U, dp = c.cycle(71, N)
    U = np.round(U / step) * step if step else U
    return U, dp, c.lagged(valve(c.lagged(U, tau_U), dp), tau_Q) + noise(71, N)


def stepped():
    U, dp = c.structured(per_level=300)
    return U, dp, c.lagged(c.ordinary(U, dp), 0.2) + c.white(71, len(U))


HEALTHY = {
    "white": partial(cycle, c.ordinary),
    "lag of Q": partial(cycle, c.ordinary, tau_Q=0.2),
    "lag of U": partial(cycle, c.ordinary, tau_U=0.1),
    "slow noise": partial(cycle, c.ordinary, noise=c.ar),
    "misfit": partial(cycle, c.s_shape),
    "U in steps of the converter": partial(cycle, c.ordinary, step=0.05),
    "closed loop": partial(c.closed_loop, 71, N, c.ordinary),
    "scattered": partial(scattered, c.ordinary),
    "scattered misfit": partial(scattered, c.s_shape),
    "scattered, held behind a meter": partial(scattered, c.ordinary, held=2, tau=0.25),
    "steps behind a meter": stepped,
}


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(70, 80))
def test_no_lag_is_seen_in_a_u_that_jitters(seed):
    (way, dp), auto = c.cycle(seed, N), FlowMap()
    for noise in (c.white, c.ar):
        for gain in (0.3, 0.8, 1.5):
            e = noise(seed, N)
            U = c.reacting(way, e, gain)
            said, state = says(auto, U, dp, c.ordinary(U, dp) + e)
            assert said == Adaptation.REACTING
            assert auto.lags(state) == (0.0, 0.0)
    U = way + 0.3 * np.random.default_rng(seed).normal(size=N)
    _, state = says(auto, U, dp, c.ordinary(way, dp) + c.white(seed, N))
    assert auto.lags(state) == (0.0, 0.0)


@pytest.mark.parametrize("kind", HEALTHY)
@pytest.mark.parametrize("name", ESTIMATORS)
def test_nothing_else_is_taken_for_it(name, kind):
    said, _ = says(ESTIMATORS[name], *HEALTHY[kind]())
    assert said != Adaptation.REACTING


def test_a_controller_that_answers_the_sample_before_agrees_as_theory_says():
    rng = np.random.default_rng(1)
    e, way = rng.normal(size=20_000), 30.0 * np.sin(np.arange(20_000) / 300.0)
    for u, r in ((-0.5 * e, -(0.75**0.5)), (-0.5 * np.roll(e, 1), 12**-0.5)):
        state = reaction.weighed(u + way, e)
        agreed = state[reaction.AGREED] / state[reaction.JITTERY]
        assert agreed == pytest.approx(2.0 / np.pi * np.arcsin(r), abs=0.08)
        assert reaction.reacts(state, 0) == (abs(r) > 0.5)


def test_a_valve_that_first_stands_still_is_looked_at_all_the_same():
    U, dp = c.cycle(72, N)
    U[:1000], e = 50.0, c.white(72, N)
    U[1000:] = c.reacting(U, e)[1000:]
    said, _ = says(ESTIMATORS["RLS"], U, dp, c.eq7(U, dp) + e)
    assert said == Adaptation.REACTING
