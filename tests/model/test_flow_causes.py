"""The search for operators between map and samples: each is told from the others by 13 s."""

import numpy as np
import pytest

from benchmarks.one_model_rows import ROWS
from valvemap.model import flow_causes, flow_evidence
from valvemap.model.flow_map import FlowMap
from valvemap.model.flow_map_state import axes
from valvemap.model.flow_rivals import Rivals, none
from valvemap.model.kernels import flow_memory
from valvemap.model.kernels import flow_path as paths
from valvemap.model.samples import Samples

FS, N = 100.0, 1280
BOTH = axes((0.0, 100.0), (0.0, 200.0))


def valve(U, dp):
    u = np.clip((U - 4) / 96, 0, 1)
    return 14 * u * (1.15 - 0.15 * u) * np.sqrt(dp)


def cycle(seed, many=N):
    rng = np.random.default_rng(seed)

    def path(low, high):
        t, x = [0.0], [rng.uniform(low, high)]
        while t[-1] < many / FS:
            ramp, level = rng.uniform(0.4, 3.0), rng.uniform(low, high)
            t += [t[-1] + ramp, t[-1] + ramp + rng.uniform(0, 1)]
            x += [level, level]
        return np.interp(np.arange(many) / FS, t, x)

    return path(0, 100), path(3, 195)


def noise(many=N):
    return 0.4 * np.random.default_rng(1).normal(size=many)


def late(x, samples):
    return np.concatenate([np.full(samples, x[0]), x[:-samples]])


def lagging(x, tau):
    out = x.copy()
    for i in range(1, len(x)):
        out[i] = out[i - 1] + (1 - np.exp(-1 / (FS * tau))) * (x[i] - out[i - 1])
    return out


def averaged(x, samples):
    c = np.cumsum(np.concatenate([np.full(samples, x[0]), x]))
    return (c[samples:] - c[:-samples]) / samples


def behind(U, half):
    out, p = np.empty_like(U), U[0]
    for i, u in enumerate(U.tolist()):
        p = min(max(p, u - half), u + half)
        out[i] = p
    return out


def slipping(U, slip):
    out, p = np.empty_like(U), U[0]
    for i, u in enumerate(U.tolist()):
        p = u if abs(u - p) > slip else p
        out[i] = p
    return out


def found(U, dp, Q, p1=None, given=None):
    rows = np.zeros((len(U), paths.COLUMNS))
    rows[:, paths.STEP] = 1 / FS
    rows[:, paths.LEFT_U], rows[:, paths.LEFT_DP], rows[:, paths.LEFT_Q] = U, dp, Q
    rows[:, paths.LEFT_P1] = dp + 5 if p1 is None else p1
    evidence = flow_evidence.Evidence(*BOTH, rows)
    start = np.zeros(paths.PARAMETERS)
    for k, value in (given or {}).items():
        start[k] = value
    at, _ = flow_causes.search(evidence, start, Rivals(none(), start))
    return {int(k): float(at[k]) for k in np.flatnonzero(at)}


SHOWN = {
    "dead time of U": ({paths.DEAD_U: 0.15}, lambda U, dp: valve(late(U, 15), dp)),
    "dead time of the meter": ({paths.DEAD_Q: 0.15}, lambda U, dp: late(valve(U, dp), 15)),
    "lag of the spool": ({paths.LAG_U: 0.1}, lambda U, dp: valve(lagging(U, 0.1), dp)),
    "lag of the meter": ({paths.LAG_Q: 0.2}, lambda U, dp: lagging(valve(U, dp), 0.2)),
    "average": ({paths.AVERAGE: 0.8}, lambda U, dp: averaged(valve(U, dp), 80)),
    "play": ({paths.PLAY: 2.0}, lambda U, dp: valve(behind(U, 2.0), dp)),
    "friction": ({paths.STICK: 2.0}, lambda U, dp: valve(slipping(U, 2.0), dp)),
    "end of the meter": ({paths.TOP: 80.0}, lambda U, dp: np.minimum(valve(U, dp), 80)),
    "none": ({}, valve),
}


@pytest.mark.parametrize("name", SHOWN)
def test_an_operator_is_named_and_measured(name):
    expected, shown = SHOWN[name]
    U, dp = cycle(30)
    assert found(U, dp, shown(U, dp) + noise()) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("before", [150, 400])
def test_friction_is_found_wherever_it_held_the_spool_before_the_rows(before):
    U, dp = cycle(30, N + before)
    Q = valve(slipping(U, 2.0), dp) + noise(N + before)
    assert found(U[before:], dp[before:], Q[before:]) == pytest.approx({paths.STICK: 2}, rel=0.05)


def test_two_lags_at_once_are_told_apart():
    U, dp = cycle(30)
    Q = lagging(valve(late(U, 10), dp), 0.3) + noise()
    assert found(U, dp, Q) == pytest.approx({paths.DEAD_U: 0.1, paths.LAG_Q: 0.3}, rel=0.1)


def test_three_operators_are_found_together():
    U, dp = cycle(2)
    Q = averaged(valve(behind(late(U, 10), 1.5), dp), 40) + noise()
    expected = {paths.DEAD_U: 0.1, paths.PLAY: 1.5, paths.AVERAGE: 0.4}
    assert found(U, dp, Q) == pytest.approx(expected, rel=0.15)


@pytest.mark.parametrize("rival", [paths.DEAD_U, paths.LAG_Q, paths.DEAD_Q])
def test_an_operator_that_explains_the_rows_is_kept_against_one_that_hardly_gains(rival):
    U, dp = cycle(30)
    Q = valve(lagging(U, 0.02), dp) + 4.0 * noise()
    assert found(U, dp, Q, given={rival: 0.02}).keys() == {rival}


def test_an_operator_gives_way_to_one_that_is_clearly_likelier():
    U, dp = cycle(30)
    Q = lagging(valve(U, dp), 0.2) + noise()
    assert found(U, dp, Q, given={paths.DEAD_U: 0.2}) == pytest.approx({paths.LAG_Q: 0.2}, rel=0.1)


def test_choking_is_a_share_of_the_pressure_upstream():
    U, dp = cycle(30)
    p1 = dp + cycle(31)[0] * 0.5 + 2
    Q = valve(U, np.minimum(dp, 0.7 * p1)) + noise()
    assert found(U, dp, Q, p1) == pytest.approx({paths.CHOKE: 0.7}, rel=0.02)


def test_where_p2_is_0_a_choke_only_scales_the_pressure_drop_and_is_not_tried():
    """Its grid fitted these samples better, 30 σ off between them."""
    row = ROWS["meter ends at 80, ordinary"](97_200)
    estimator = FlowMap(U_range=row.U_range, dp_range=row.dp_range)
    state, _ = estimator.update(estimator.initial_state(), row.samples[:4_400])
    assert state.path[paths.CHOKE] == 0.0


def test_a_least_flow_is_what_readings_jump_over():
    Q = np.concatenate([np.linspace(0, 9, 60), np.linspace(9, 0, 60)] * 3) + 0.01
    assert flow_causes.least_shown(np.where(Q < 3, 0.0, Q), 0.2)[1] > 0.0
    assert flow_causes.least_shown(Q, 0.2)[1] == 0.0


def learnt(U, dp, Q, cuts=(), t=None):
    t = np.arange(len(U)) / FS if t is None else t
    t = 1_700_000_000_000_000_000 + (1e9 * t).astype(np.int64)
    samples, state, start = Samples.of(t, U, dp, 0 * dp, Q), FlowMap().initial_state(), 0
    for stop in (*cuts, len(U)):
        state, _ = FlowMap().update(state, samples[start:stop])
        start = stop
    return state


@pytest.mark.parametrize(
    ("shown", "highest"),
    [
        (lambda U, dp: late(valve(U, dp), 15), 190),
        (lambda U, dp: averaged(valve(U, dp), 80), 190),
        (lambda U, dp: np.minimum(valve(U, dp), 80), 75),
    ],
    ids=["dead time", "average", "end of the meter"],
)
def test_the_map_is_that_of_the_valve_not_of_the_meter(shown, highest):
    U, dp = cycle(40, 12_000)
    state = learnt(U, dp, shown(U, dp) + noise(12_000))
    rng = np.random.default_rng(9)
    U, dp = rng.uniform(5, 95, 500), rng.uniform(10, 190, 500)
    U, dp = (x[valve(U, dp) < highest] for x in (U, dp))
    Q, _ = FlowMap().predict(state, U, dp, np.full(len(U), 40.0))
    assert np.sqrt(np.mean((Q - valve(U, dp)) ** 2)) < 1.0 * 0.4


def test_beyond_a_compensators_knee_the_flow_that_is_asked_is_that_of_the_knee():
    U, dp = cycle(30, 3000)
    state = learnt(U, dp, valve(U, dp) + noise(3000))
    state.path[paths.KNEE] = 40.0
    at = np.full(3, 60.0), np.array([40.0, 60.0, 180.0]), np.full(3, 40.0)
    flow, _ = FlowMap().predict(state, *at)
    assert (flow == flow[0]).all()
    assert FlowMap().inverted(state, flow, *at[1:])[0] == pytest.approx(60.0, abs=1e-6)


def choked(seed, N):
    U, dp = cycle(seed, N)
    p1 = dp + cycle(seed + 1, N)[0] * 0.5 + 2
    return U, dp, p1, valve(U, np.minimum(dp, 0.7 * p1)) + noise(N)


def test_the_doubt_about_an_operator_is_its_laplace_approximation():
    U, dp, p1, Q = choked(30, N)
    rows = np.zeros((N, paths.COLUMNS))
    rows[:, paths.STEP], rows[:, paths.LEFT_U], rows[:, paths.LEFT_DP] = 1 / FS, U, dp
    rows[:, paths.LEFT_P1], rows[:, paths.LEFT_Q] = p1, Q
    evidence = flow_evidence.Evidence(*BOTH, rows)
    start = np.zeros(paths.PARAMETERS)
    at, _ = flow_causes.search(evidence, start, Rivals(none(), start))
    std = flow_evidence.precision(evidence, at)[paths.CHOKE, paths.CHOKE] ** -0.5
    off = flow_evidence.with_value(at, paths.CHOKE, at[paths.CHOKE] + 2.0 * std)
    assert evidence.gain(at, off) == pytest.approx(2.0, rel=0.5)


def test_later_rows_refine_an_operator_and_move_the_map_with_it():
    U, dp, p1, Q = choked(30, 9000)
    t = (1e9 / FS * np.arange(9000)).astype(np.int64)
    samples, state = Samples.of(t, U, p1, p1 - dp, Q), FlowMap().initial_state()
    state, _ = FlowMap().update(state, samples[:2000])
    young, began = state.doubt.max(), state.counters[flow_memory.BEGAN]
    state, _ = FlowMap().update(state, samples[2000:])
    assert 0.0 < state.doubt.max() < young
    assert state.counters[flow_memory.BEGAN] == began
    assert state.path[paths.CHOKE] == pytest.approx(0.7, abs=0.005)


def test_a_fast_spool_is_found_though_samples_come_in_pieces():
    U, dp = cycle(30, 2600)
    Q = valve(lagging(U, 0.015), dp) + 0.25 * noise(2600)
    t = np.arange(2600) / FS
    shown = t % 2.0 < 1.0  # the rows kept span 25 s, 1700 times the lag
    state = learnt(U[shown], dp[shown], Q[shown], t=t[shown])
    assert state.path[paths.LAG_U] == pytest.approx(0.015, rel=0.2)
    grid_U, grid_dp = (x.ravel() for x in np.meshgrid([30.0, 50.0, 70.0], [40.0, 80.0, 120.0]))
    Q, _ = FlowMap().predict(state, grid_U, grid_dp, np.full(9, np.nan))
    assert np.abs(Q - valve(grid_U, grid_dp)).max() < 0.4


def test_a_search_does_not_depend_on_how_samples_are_cut():
    U, dp = cycle(41, 2600)
    Q = late(valve(U, dp), 15) + noise(2600)
    whole, cut = learnt(U, dp, Q), learnt(U, dp, Q, (1, 700, 1229, 1230, 2000))
    assert whole.path[paths.DEAD_Q] > 0.0
    for name in ("theta", "std", "path", "recent", "counters"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(cut, name))
