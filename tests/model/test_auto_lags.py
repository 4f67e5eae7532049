"""`Auto` behind lags: they are found, the map is as good as without, and no loop is claimed."""

import numpy as np
import pytest

from support.missed import missed
from support.soaked import soaked
from valvemap.model.flow_map import FlowMap
from valvemap.model.samples import Samples
from valvemap_rig.scenario import BUILTIN
from valvemap_rig.simulation import advance, initial

SIGMA, N = 0.4, 20_000
LOOKS = 2_100  # samples; after which lags were looked for twice


def valve(U, dp):
    u = np.clip((U - 5) / 95, 0, 1)
    return 13 * u * (1.1 - 0.1 * u) * np.sqrt(dp)


def ramps_and_holds(rng, n, low, high, fs):
    t, x = [0.0], [rng.uniform(low, high)]
    while t[-1] < n / fs:
        ramp, level = rng.uniform(0.4, 3.0), rng.uniform(low, high)
        t += [t[-1] + ramp, t[-1] + ramp + rng.uniform(0, 1.0)]
        x += [level, level]
    return np.interp(np.arange(n) / fs, t, x)


def lagged(x, tau, fs):
    share = 1 - np.exp(-1 / (fs * tau)) if tau > 0 else 1.0
    out, y = np.empty(len(x)), x[0]
    for i, value in enumerate(x):
        y += share * (value - y)
        out[i] = y
    return out


def machine(seed, tau_U=0.0, tau_Q=0.0, fs=100.0, n=N):
    """A machine's cycle; the noise comes after the lags."""
    rng = np.random.default_rng(seed)
    U, dp = ramps_and_holds(rng, n, 0, 100, fs), ramps_and_holds(rng, n, 3, 195, fs)
    Q = lagged(valve(lagged(U, tau_U, fs), dp), tau_Q, fs) + SIGMA * rng.standard_normal(n)
    t = 1_700_000_000_000_000_000 + np.round(np.arange(n) * 1e9 / fs).astype(np.int64)
    return Samples.of(t, U, dp + 5, np.full(n, 5.0), Q, np.full(n, 40.0))


def lags_of(U, dp, Q, fs=100.0):
    """Lags found in such samples."""
    t, auto = np.round(np.arange(len(U)) * 1e9 / fs).astype(np.int64), FlowMap()
    state, _ = auto.update(auto.initial_state(), Samples.of(t, U, dp, 0 * dp, Q))
    return auto.lags(state)


def error_inside(auto, state, samples):
    """RMSE in σ where at least three samples lie within 5 % and 5 bar."""
    rng = np.random.default_rng(0)
    U, dp = rng.uniform(0, 100, 400), rng.uniform(1, 199, 400)
    every = samples[::5]
    near = (np.abs(U[:, None] - every.U) < 5) & (np.abs(dp[:, None] - every.dp) < 5)
    inside = near.sum(axis=1) >= 3
    Q, _ = auto.predict(state, U[inside], dp[inside], np.full(inside.sum(), 40.0))
    return np.sqrt(np.mean((Q - valve(U, dp)[inside]) ** 2)) / SIGMA


LAGS = (*((0.0, tau) for tau in (0.0, 0.05, 0.2, 0.3)), (0.1, 0.0), (0.05, 0.05))  # of U, of Q


@pytest.mark.parametrize(
    ("tau_U", "tau_Q", "seeds"),
    [
        *((*lags, (3,)) for lags in ((0.0, 0.0), (0.0, 0.3), (0.05, 0.05))),
        *(pytest.param(*lags, (3, 4), marks=pytest.mark.soak) for lags in LAGS),
    ],
)
def test_lags_are_found_and_the_map_is_good_and_without_a_loop(tau_U, tau_Q, seeds):
    errors = []
    for seed in seeds:
        samples, auto = machine(seed, tau_U, tau_Q), FlowMap()
        state, _ = auto.update(auto.initial_state(), samples)
        for found, true in zip(auto.lags(state), (tau_U, tau_Q), strict=True):
            assert found == pytest.approx(true, rel=0.2, abs=0.01)
        assert auto.half_play(state) == 0.0
        errors.append(error_inside(auto, state, samples))
    assert np.mean(errors) <= 0.6, errors


@pytest.mark.parametrize(
    "fs",
    [
        *(50.0, 200.0),
        pytest.param(1000.0, marks=missed("not found: the rows that are kept are 1.3 s")),
    ],
)
def test_the_rate_of_the_samples_does_not_matter_to_a_lag(fs):
    auto = FlowMap()
    state, _ = auto.update(auto.initial_state(), machine(5, 0.0, 0.2, fs))
    assert auto.lags(state)[1] == pytest.approx(0.2, rel=0.2)


@pytest.mark.parametrize("fs", [1.0, 5.0, 10.0, 20.0])
def test_slow_samples_without_a_lag_make_none(fs):
    samples, auto = machine(int(fs), fs=fs, n=3000), FlowMap()
    state, _ = auto.update(auto.initial_state(), samples)
    assert auto.lags(state) == (0.0, 0.0)
    assert error_inside(auto, state, samples) <= 0.6


@pytest.mark.parametrize("seed", [0, 1, *soaked(2, 3)])
def test_samples_scattered_a_tenth_of_a_second_apart_make_no_lag(seed):
    rng = np.random.default_rng(seed)
    U, dp = rng.uniform(0, 100, LOOKS), rng.uniform(2, 198, LOOKS)
    Q = valve(U, dp) + SIGMA * rng.normal(size=LOOKS)
    assert lags_of(U, dp, Q, fs=10.0) == (0.0, 0.0)


def test_a_lag_of_two_slow_steps_is_found():
    auto, samples = FlowMap(), machine(5, 0.0, 0.2, fs=10.0, n=5000)
    state, _ = auto.update(auto.initial_state(), samples)
    assert auto.lags(state) == pytest.approx((0.0, 0.2), rel=0.2, abs=0.01)


@pytest.mark.parametrize(
    ("tau_Q", "seed"),
    [
        *((tau, 0) for tau in (0.1, 0.25, 0.0)),
        *soaked(*((tau, seed) for tau in (0.1, 0.25) for seed in (1, 2)), (0.0, 2)),
        (0.0, 1),
    ],
)
def test_a_noisy_sensor_of_U_neither_makes_a_lag_nor_hides_one(seed, tau_Q):
    samples = machine(seed, 0.0, tau_Q, n=LOOKS)
    U = samples.U + 0.4 * np.random.default_rng(seed).normal(size=LOOKS)
    assert lags_of(U, samples.dp, samples.Q) == pytest.approx((0.0, tau_Q), rel=0.2, abs=0.01)


@pytest.mark.parametrize(
    ("fs", "tau_Q", "seed"),
    [
        case
        for of in ((100.0, 0.0), (100.0, 0.1), (10.0, 0.0), (10.0, 0.3))
        for case in ((*of, 0), *soaked((*of, 1)))
    ],
)
def test_noisy_pressures_neither_make_a_lag_nor_hide_one(seed, fs, tau_Q):
    samples = machine(seed, 0.0, tau_Q, fs, n=LOOKS)
    dp = np.abs(samples.dp + 0.7 * np.random.default_rng(seed).normal(size=LOOKS))
    assert lags_of(samples.U, dp, samples.Q, fs) == pytest.approx((0.0, tau_Q), rel=0.2, abs=0.01)


def test_a_signal_that_stands_still_tells_no_lag():
    Q = 70.0 + np.random.default_rng(0).normal(size=LOOKS)
    assert lags_of(np.full(LOOKS, 50.0), np.full(LOOKS, 100.0), Q) == (0.0, 0.0)


@pytest.mark.parametrize("seed", [0, 1, *soaked(2, 3)])
def test_a_slow_meters_lag_is_not_shared_out_to_u(seed):
    samples = machine(seed, 0.0, 0.2, n=LOOKS)
    found = lags_of(samples.U, samples.dp, samples.Q)
    assert found[0] <= 0.01
    assert found[1] == pytest.approx(0.2, rel=0.1)


@pytest.fixture(scope="module")
def demo():
    """What the rig's demo shows: points drawn anew every 20 ms, oil that warms up, a hysteresis."""
    scenario = BUILTIN["demo"]
    _, block = advance(scenario, initial(scenario, 1_700_000_000_000_000_000), 39_100)
    (valve,) = block.valves.values()
    return Samples.of(valve.t, valve.U, valve.p1, valve.p2, valve.Q, valve.T)


@pytest.mark.parametrize("first", [951, 6657, 7291, *soaked(25677, 26945, 34553, 37089)])
def test_no_lag_is_claimed_of_which_the_rows_themselves_speak_against(demo, first):
    """Lags of 300 ms were, in noise of a correlation that is theirs."""
    auto, some = FlowMap(), demo[first : first + 1981]
    state = auto.initial_state()
    for k in range(0, len(some), 500):
        state, _ = auto.update(state, some[k : k + 500])
        assert auto.lags(state) == (0.0, 0.0)
