"""`Auto` behind lags: they are found, the map is as good as without, and no loop is claimed."""

import numpy as np
import pytest

from valvemap.model.auto import Auto
from valvemap.model.auto_anew import Rule, begin_anew
from valvemap.model.fleet import copied
from valvemap.model.kernels import cells as memory
from valvemap.model.kernels import grid
from valvemap.model.kernels import lag as kernel
from valvemap.model.lag_search import look
from valvemap.model.map_shapes import Shape
from valvemap.model.samples import Samples
from valvemap_rig.scenario import BUILTIN
from valvemap_rig.simulation import advance, initial

SIGMA, N = 0.4, 20_000


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


def error_inside(auto, state, samples):
    """RMSE in σ where at least three samples lie within 5 % and 5 bar."""
    rng = np.random.default_rng(0)
    U, dp = rng.uniform(0, 100, 400), rng.uniform(1, 199, 400)
    every = samples[::5]
    near = (np.abs(U[:, None] - every.U) < 5) & (np.abs(dp[:, None] - every.dp) < 5)
    inside = near.sum(axis=1) >= 3
    Q, _ = auto.predict(state, U[inside], dp[inside], np.full(inside.sum(), 40.0))
    return np.sqrt(np.mean((Q - valve(U, dp)[inside]) ** 2)) / SIGMA


@pytest.mark.parametrize(
    ("tau_U", "tau_Q"),
    [(0.0, 0.0), (0.0, 0.05), (0.0, 0.2), (0.0, 0.3), (0.1, 0.0), (0.05, 0.05)],
)
def test_lags_are_found_and_the_map_is_good_and_without_a_loop(tau_U, tau_Q):
    errors = []
    for seed in (3, 4, 5):
        samples, auto = machine(seed, tau_U, tau_Q), Auto()
        state, _ = auto.update(auto.initial_state(), samples)
        for found, true in zip(auto.lags(state), (tau_U, tau_Q), strict=True):
            assert found == pytest.approx(true, rel=0.2, abs=0.01)
        assert Shape.from_array(state.shapes[0]).play == 0.0
        errors.append(error_inside(auto, state, samples))
    assert np.mean(errors) <= 0.6, errors


def test_what_a_slow_meter_showed_is_taken_back_whatever_the_flow_was(monkeypatch):
    for name in ("share", "_smooth"):  # Python cannot call them compiled
        monkeypatch.setattr(kernel, name, getattr(kernel, name).py_func)
    tau, step = 0.3, 0.01
    of_S = kernel.smoothing(step, tau)
    flow = np.cumsum(np.random.default_rng(1).normal(size=400))
    path, counters = np.zeros(kernel.SCALARS), np.zeros(kernel.COUNTERS, np.int64)
    path[kernel.LAG_Q], path[kernel.SMOOTHING] = tau, of_S
    path[kernel.U_EFFECT] = path[kernel.Q_FIRST] = np.nan
    smooth = lagged(lagged(flow, of_S, 1 / step), of_S, 1 / step)
    found = []
    for i, Q in enumerate(lagged(flow, tau, 1 / step)):
        kernel.follow.py_func(i * 10_000_000, 0.0, 0.0, path, counters)
        found.append(kernel.uncover.py_func(Q, path))
    assert np.allclose(found[1:], smooth[1:], rtol=0.0, atol=1e-9)


def test_smoothing_leaves_as_much_noise_as_it_may():
    rng, step = np.random.default_rng(2), 0.01
    for tau in (0.02, 0.1, 0.3):
        of_S = kernel.smoothing(step, tau)
        first = lagged(rng.normal(size=20_000), of_S, 1 / step)
        second = lagged(first, of_S, 1 / step)
        found = second + tau / of_S * (first - second)
        assert of_S < tau
        noisier = np.std(found) / np.sqrt(kernel.NOISIER)
        assert noisier <= 1.2
        assert noisier >= 0.8 or of_S < step  # of lags so short all of S is one step


def anew(seed, n, before=(0.0, 0.3), now=(0.03, 0.3)):
    """A state behind lags that turn out to be others: before its map begins anew, and after."""
    auto, samples = Auto(), machine(seed, *now, n=n)
    state, _ = Auto(lag_U=before[0], lag_Q=before[1]).update(
        Auto(lag_U=before[0], lag_Q=before[1]).initial_state(), samples
    )
    after = copied(state)
    path = after.scalars[memory.LAGS :]
    path[kernel.LAG_U], path[kernel.LAG_Q] = now
    begin_anew(after, Rule((None, None), 500.0, auto.steps), before, 40.0)
    return auto, samples, state, after


def test_a_map_that_begins_anew_keeps_the_places_it_came_to_long_ago_for_what_they_are_worth():
    errors = []
    for seed in (3, 4, 5, 6):
        auto, samples, before, after = anew(seed, 5000)
        bare = copied(before)
        bare.cells[:, grid.WEIGHT] = 0.0
        begin_anew(bare, Rule((None, None), 500.0, auto.steps), (0.0, 0.3), 40.0)
        early = samples[: len(samples) - 2 * kernel.ROWS]
        errors.append([error_inside(auto, state, early) for state in (after, bare)])
        weights = [state.cells[:, grid.WEIGHT] for state in (before, after)]
        visited = weights[0] > 10.0
        assert 0.0 < np.median(weights[1][visited]) < 0.5 * np.median(weights[0][visited])
    kept, forgotten = np.mean(errors, axis=0)
    assert kept < 0.8 * forgotten


def test_what_was_learnt_behind_lags_far_off_is_forgotten_but_for_the_last_rows():
    _, _, _, after = anew(3, 5000, before=(0.0, 0.0), now=(0.0, 0.3))
    points = after.cells[after.cells[:, grid.WEIGHT] > 0.0]
    assert points[:, grid.WEIGHT].sum() <= kernel.ROWS
    assert len(points) > 0


def test_rows_that_are_learnt_again_count_once():
    _, _, before, after = anew(4, 3000)
    kept = [memory.USED, memory.TOO_FAST, memory.ALARMS, memory.NEXT_LOOK]
    kept += range(memory.LAGGING, memory.COUNTERS)
    np.testing.assert_array_equal(after.counters[kept], before.counters[kept])
    np.testing.assert_array_equal(after.recent, before.recent)
    assert after.counters[memory.BEGAN] == before.counters[memory.USED]
    assert after.counters[memory.FITTED] == 1


def test_rows_from_before_a_change_are_not_learnt_again():
    auto, samples, before, _ = anew(4, 3000)
    for since, learns in ((samples.t[-300], True), (samples.t[-1] + 1, False)):
        state = copied(before)
        state.cells[:, grid.WEIGHT] = 0.0
        state.counters[memory.ALARMS], state.counters[memory.CHANGE_TIME] = 1, since
        begin_anew(state, Rule((None, None), 500.0, auto.steps), (0.0, 0.3), 40.0)
        assert 0.0 <= state.cells[:, grid.WEIGHT].sum() <= 300.0
        assert (state.counters[memory.FITTED] == 1) == learns


def test_the_rate_of_the_samples_does_not_matter_to_a_lag():
    auto = Auto()
    for fs in (50.0, 1000.0):
        state, _ = auto.update(auto.initial_state(), machine(5, 0.0, 0.2, fs))
        assert auto.lags(state)[1] == pytest.approx(0.2, rel=0.2)


@pytest.mark.parametrize("fs", [1.0, 5.0, 10.0, 20.0])
def test_slow_samples_without_a_lag_make_none(fs):
    samples, auto = machine(int(fs), fs=fs, n=3000), Auto()
    state, _ = auto.update(auto.initial_state(), samples)
    assert auto.lags(state) == (0.0, 0.0)
    assert error_inside(auto, state, samples) <= 0.6


@pytest.mark.parametrize("seed", range(4))
def test_samples_scattered_a_tenth_of_a_second_apart_make_no_lag(seed):
    rng = np.random.default_rng(seed)
    U, s = rng.uniform(0, 100, kernel.ROWS), np.sqrt(rng.uniform(2, 198, kernel.ROWS))
    Q = valve(U, s**2) + SIGMA * rng.normal(size=len(U))
    rows = np.stack([np.full(len(U), 0.1), U, s, Q], axis=1)
    assert look(rows, np.zeros(6), (None, None)) == (0.0, 0.0)


def test_a_lag_of_two_slow_steps_is_found():
    auto, samples = Auto(), machine(5, 0.0, 0.2, fs=10.0, n=5000)
    state, _ = auto.update(auto.initial_state(), samples)
    assert auto.lags(state) == pytest.approx((0.0, 0.2), rel=0.2, abs=0.01)


def test_a_lag_that_is_given_is_taken_and_no_other_is_looked_for():
    auto = Auto(lag_U=0.0, lag_Q=0.2)
    samples = machine(4, 0.0, 0.2)
    state, _ = auto.update(auto.initial_state(), samples)
    assert auto.lags(state) == (0.0, 0.2)
    assert error_inside(auto, state, samples) <= 1.0
    assert auto.too_fast(state) > 0
    with pytest.raises(ValueError, match="not a time"):
        Auto(lag_Q=-1.0)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("tau_Q", [0.0, 0.1, 0.25])
def test_a_noisy_sensor_of_U_neither_makes_a_lag_nor_hides_one(seed, tau_Q):
    samples = machine(seed, 0.0, tau_Q, n=kernel.ROWS)
    U = samples.U + 0.4 * np.random.default_rng(seed).normal(size=len(samples))
    rows = np.stack([np.full(len(U), 0.01), U, np.sqrt(samples.dp), samples.Q], axis=1)
    found = look(rows, np.zeros(6), (None, None))
    assert found == pytest.approx((0.0, tau_Q), rel=0.2, abs=0.01)


@pytest.mark.parametrize(("fs", "tau_Q"), [(100.0, 0.0), (100.0, 0.1), (10.0, 0.0), (10.0, 0.3)])
@pytest.mark.parametrize("seed", range(2))
def test_noisy_pressures_neither_make_a_lag_nor_hide_one(seed, fs, tau_Q):
    samples = machine(seed, 0.0, tau_Q, fs, n=kernel.ROWS)
    dp = np.abs(samples.dp + 0.7 * np.random.default_rng(seed).normal(size=len(samples)))
    rows = np.stack([np.full(len(dp), 1 / fs), samples.U, np.sqrt(dp), samples.Q], axis=1)
    assert look(rows, np.zeros(6), (None, None)) == pytest.approx((0.0, tau_Q), rel=0.2, abs=0.01)


def test_a_signal_that_stands_still_tells_no_lag():
    rows = np.zeros((kernel.ROWS, 4))
    rows[:, kernel.STEP], rows[:, kernel.LEFT_U] = 0.01, 50.0
    rows[:, kernel.LEFT_S] = 10.0
    rows[:, kernel.LEFT_Q] = 70.0 + np.random.default_rng(0).normal(size=kernel.ROWS)
    known = np.zeros(6)
    assert look(rows, known, (None, None)) == (0.0, 0.0)
    assert not known.any()


@pytest.mark.parametrize("seed", range(4))
def test_a_slow_meters_lag_is_not_shared_out_to_u(seed):
    samples = machine(seed, 0.0, 0.2, n=kernel.ROWS)
    steps = np.full(len(samples), 0.01)
    rows = np.stack([steps, samples.U, np.sqrt(samples.dp), samples.Q], axis=1)
    found = look(rows, np.zeros(6), (None, None))
    assert found[0] <= 0.01
    assert found[1] == pytest.approx(0.2, rel=0.1)


def test_without_a_lag_no_sample_is_too_fast():
    samples, auto = machine(6, n=4000), Auto()
    state, _ = auto.update(auto.initial_state(), samples)
    assert auto.too_fast(state) == 0


def rows_of(seed, tau_Q, gain=1.0, *, still=False):
    """The last samples as `Auto` keeps them."""
    samples = machine(seed, 0.0, tau_Q, n=kernel.ROWS)
    U, s, Q = samples.U, np.sqrt(samples.dp), gain * samples.Q
    if still:
        U, s, Q = np.full_like(U, 50.0), np.full_like(s, 10.0), 70.0 + 0.1 * Q
    return np.stack([np.full(len(Q), 0.01), U, s, Q], axis=1)


def test_a_lag_in_doubt_stays_unless_the_rows_clearly_speak_against_it():
    known = np.zeros(6)
    for seed in range(3):
        lags = look(rows_of(seed, 0.05), known, (None, None))
    before = known.copy()
    for rows in (rows_of(7, 0.05, gain=0.7), rows_of(8, 0.05, still=True)):
        assert look(rows, known, (None, None), lags, doubted=True) == lags
        np.testing.assert_array_equal(known, before)
    found = look(rows_of(9, 0.2), known, (None, None), lags, doubted=True)
    assert found[1] == pytest.approx(0.2, rel=0.2)


@pytest.mark.parametrize(
    ("gain", "at_first", "once_claimed"), [(5.0, 0.0, 0.0), (20.0, 0.0, 0.03), (60.0, 0.03, 0.03)]
)
def test_a_lag_that_is_claimed_stays_until_next_to_nothing_speaks_for_it(
    gain, at_first, once_claimed
):
    U, Q, uu, qq = 0.03, 0.3, gain / 0.03**2, 1e5
    known = np.array([1.0, uu, 0.0, qq, uu * U, qq * Q])
    rows = rows_of(0, Q, still=True)  # tell nothing
    for before, expected in (((0.0, Q), at_first), ((U, Q), once_claimed)):
        found = look(rows, known.copy(), (None, None), before)
        assert found == pytest.approx((expected, Q), abs=0.01)


@pytest.mark.parametrize("lag_Q", [0.0, 0.1])
def test_after_a_doubt_lags_are_looked_for_as_often_as_at_first_and_where_there_is_one_stay_so(
    lag_Q,
):
    auto, samples = Auto(), machine(10, 0.0, lag_Q, n=12 * kernel.ROWS)
    state, _ = auto.update(auto.initial_state(), samples[: 5 * kernel.ROWS])
    at = memory.LAGGING + kernel.LOOKED_FROM
    state.counters[at] = state.counters[memory.LAGGING + kernel.KEPT_ROWS]
    state.counters[memory.NEXT_LOOK] = state.counters[at] + kernel.ROWS
    looks = [0]
    for first in range(5 * kernel.ROWS, len(samples), kernel.ROWS // 2):
        state, _ = auto.update(state, samples[first : first + kernel.ROWS // 2])
        looks.append(int(state.counters[memory.NEXT_LOOK] - state.counters[at]) // kernel.ROWS)
    assert sorted(set(looks) - {0}) == ([*range(1, 9)] if lag_Q else [1, 2, 4, 8])
    assert auto.lags(state)[1] == pytest.approx(lag_Q, rel=0.2)


@pytest.fixture(scope="module")
def demo():
    """What the rig's demo shows: points drawn anew every 20 ms, oil that warms up, a hysteresis."""
    scenario = BUILTIN["demo"]
    _, block = advance(scenario, initial(scenario, 1_700_000_000_000_000_000), 39_100)
    (valve,) = block.valves.values()
    return Samples.of(valve.t, valve.U, valve.p1, valve.p2, valve.Q, valve.T)


@pytest.mark.parametrize("first", [951, 6657, 7291, 25677, 26945, 34553, 37089])
def test_no_lag_is_claimed_of_which_the_rows_themselves_speak_against(demo, first):
    """Lags of 300 ms were, in noise of a correlation that is theirs."""
    auto, some = Auto(), demo[first : first + 1981]
    state = auto.initial_state()
    for k in range(0, len(some), 500):
        state, _ = auto.update(state, some[k : k + 500])
        assert auto.lags(state) == (0.0, 0.0)
