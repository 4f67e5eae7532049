"""Dynamics of spool and meter: recovered from steps, refused where nothing tells them."""

import math

import numpy as np
import pytest

from valvemap.model import spool_fit as fit
from valvemap.model import spool_model as spool
from valvemap.model.dynamics import Dynamics, fit_dynamics
from valvemap.model.kernels import dynamics as kernels
from valvemap.model.samples import Samples
from valvemap.vocabulary.statuses import Status

FINE, F, ZETA, LAG, SIGMA = 100, 12.0, 0.7, 0.02, 0.1


def stepped(seconds=12.0, rate=100, seed=0, lag=LAG, play=0.0):
    """Steps of U behind a spool without a slew limit, and a meter; flow 0.1·x·√Δp."""
    rng = np.random.default_rng(seed)
    N, h = round(seconds * rate), 1.0 / (rate * FINE)
    U = np.repeat(rng.uniform(5.0, 95.0, N // 25 + 1), 25)[:N]
    dp = 60.0 + 40.0 * np.sin(np.arange(N) / rate)
    behind = np.empty(N)
    kernels.behind(U, 0.5 * play, behind)
    w, x, v, y, Q = 2 * math.pi * F, U[0], 0.0, 0.1 * U[0] * math.sqrt(dp[0]), np.empty(N)
    for k in range(N):
        Q[k] = y
        for i in range(FINE):
            s = math.sqrt(60.0 + 40.0 * math.sin(k / rate + i * h))
            v += h * (w * w * (behind[k] - x) - 2 * ZETA * w * v)
            x += h * v
            y += h / lag * (0.1 * x * s - y)
    Q += rng.normal(0.0, SIGMA, N)
    return Samples.of(np.arange(N) * (10**9 // rate), U, dp, 0 * U, Q)


@pytest.fixture(scope="module")
def found():
    """One fit for all checks, 3 s of processor time: five numbers are searched for."""
    return fit_dynamics(stepped())


def test_frequency_damping_and_meter_lag_are_found_within_their_intervals(found):
    assert isinstance(found, Dynamics)
    for one, truth, near in (
        (found.natural_frequency, F, 0.03 * F),
        (found.damping, ZETA, 0.05),
        (found.meter_lag, LAG, 0.002),
    ):
        assert one.status is Status.OK
        assert abs(one.value - truth) < near
        assert abs(one.value - truth) < 4.0 * one.std + 0.01 * truth


@pytest.mark.parametrize(
    "law",
    [
        lambda dp: np.sqrt(dp + 2.25) - 1.5,
        lambda dp: np.sqrt(dp) * (1.0 - 4e-4 * dp),
        lambda dp: 8.0 * np.ones_like(dp),
    ],
    ids=["laminar gap", "flow forces", "compensator"],
)
def test_the_map_follows_other_laws_of_the_pressure_drop_within_a_tenth_of_the_noise(law):
    rng = np.random.default_rng(4)
    U, dp = rng.uniform(0.0, 100.0, 4_000), rng.uniform(20.0, 160.0, 4_000)
    s = np.sqrt(dp)
    X = spool.static_columns(U, s / s.max(), (-20.0, 3.5, s.max()))
    left, _, _ = spool._left(X, 14.0 * (U / 100.0) ** 1.3 * law(dp))
    assert np.sqrt(np.mean(left**2)) < 0.04


@pytest.mark.soak
def test_a_slow_meter_is_not_taken_for_another_spool():
    found = fit_dynamics(stepped(10.0, lag=0.3))
    assert found.meter_lag.value == pytest.approx(0.3, rel=0.02)
    assert found.natural_frequency.value == pytest.approx(F, rel=0.15)
    assert found.noise < 1.1 * SIGMA


def test_a_search_from_the_delay_begins_near_a_slow_meter():
    starts = fit._of_delay(fit._gridded(stepped(10.0, lag=0.3), 0.01))
    assert any(0.15 < p.lag < 0.45 and p.f > 5.0 for p in starts)


def test_a_play_is_found_beside_the_spool():
    grid = fit._gridded(stepped(10.0, play=4.0), 0.01)
    without, _ = fit.descend(grid, spool.Point(F, ZETA, spool.NO_SLEW, 0.0, LAG))
    assert abs(without.lag - LAG) > 0.002
    _, p = fit._with_play(grid, without)
    assert p.play == pytest.approx(4.0, abs=0.1)
    assert p.f == pytest.approx(F, rel=0.02)
    assert p.lag == pytest.approx(LAG, abs=0.001)


def test_a_slew_limit_that_is_never_reached_is_not_excited(found):
    assert found.slew.status is Status.UNEXCITED
    assert math.isnan(found.slew.value)


def test_the_static_map_is_found_behind_the_dynamics(found):
    U, dp = np.array([20.0, 50.0, 80.0]), np.array([40.0, 60.0, 90.0])
    assert found.flow(U, dp) == pytest.approx(0.1 * U * np.sqrt(dp), abs=0.3)


def test_t90_is_that_of_the_step_response(found):
    w, damped = 2 * math.pi * F, 2 * math.pi * F * math.sqrt(1 - ZETA**2)
    t = np.linspace(0.0, 0.2, 20_001)
    x = 1 - np.exp(-ZETA * w * t) * (np.cos(damped * t) + ZETA * w / damped * np.sin(damped * t))
    assert found.T90.value == pytest.approx(t[np.argmax(x >= 0.9)], abs=1e-3)
    times, travel = found.step_response()
    assert travel[-1] == pytest.approx(found.step_percent, rel=0.01)
    assert np.all(np.diff(times) > 0)


@pytest.mark.parametrize(
    ("samples", "why"),
    [
        (stepped(2.0), "too few"),
        (stepped(100.0, rate=10), "too slow"),
    ],
)
def test_what_cannot_tell_is_refused_with_a_sentence(samples, why):
    assert why in fit_dynamics(samples).sentence


def test_a_valve_at_rest_is_refused():
    N = 2_000
    still = Samples.of(
        np.arange(N) * 10**7, np.full(N, 30.0), np.full(N, 60.0), np.zeros(N), np.ones(N)
    )
    assert "U moves too little" in fit_dynamics(still).sentence


def test_a_spool_that_follows_at_once_is_not_excited():
    rng = np.random.default_rng(2)
    t, U, dp = np.arange(1_000) * 10**7, rng.uniform(0, 100, 1_000), rng.uniform(20, 150, 1_000)
    Q = 0.1 * U * np.sqrt(dp) + rng.normal(0.0, SIGMA, 1_000)
    found = fit_dynamics(Samples.of(t, U, dp, 0 * U, Q))
    for one in (found.natural_frequency, found.damping, found.dead_time, found.T90):
        assert one.status is Status.UNEXCITED
        assert math.isnan(one.value)


def test_few_moves_tell_no_dynamics():
    samples = stepped(30.0)
    held = np.repeat([20.0, 40.0, 60.0], 1_000)
    moved = Samples.of(samples.t, held, samples.p1, samples.p2, samples.Q)
    assert "U moves too little" in fit_dynamics(moved).sentence


@pytest.mark.parametrize("flow", [0.0, pytest.param(50.0, marks=pytest.mark.soak)])
def test_a_flow_that_does_not_move_tells_nothing(flow):
    samples = stepped(10.0)
    constant = Samples.of(samples.t, samples.U, samples.p1, samples.p2, 0.0 * samples.Q + flow)
    found = fit_dynamics(constant)
    for one in (found.natural_frequency, found.damping, found.slew, found.T90):
        assert one.status is Status.UNEXCITED


@pytest.mark.parametrize(("f", "share"), [(60.0, 0.15), (60.0, 0.3), (30.0, 0.15), (20.0, 0.3)])
def test_a_step_to_the_slew_limit_is_as_late_as_in_much_shorter_steps(f, share):
    h, step, slew = spool.STEP_S, 50.0, share * 240.0 * f
    n = round((step / slew + 3.0 / f) / h)
    x = {}
    for parts in (1, 64):
        P = spool._transition(spool.Point(f, 0.6, slew, 0.0, 0.0), h / parts)
        fine = np.empty(n * parts)
        kernels.spool(np.full(n * parts, step), P, slew * h / parts, fine)
        x[parts] = fine[parts - 1 :: parts]
    assert abs(np.sum(x[64] - x[1])) * h / step < 2e-6  # s; 19e-6 if it is cut off in the first
