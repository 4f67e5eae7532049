"""A dead time of the meter where U and Δp move by much within a sample."""

import numpy as np
import pytest

from benchmarks.drawn_plants import drawn
from support.soaked import soaked
from valvemap.model.fleet import alone, member
from valvemap.model.flow_map import FlowMap
from valvemap.model.kernels.flow_path import DEAD_Q, DEAD_U
from valvemap.model.samples import Samples
from valvemap.vocabulary.findings import FindingCode

SIGMA = 0.4


def flow(U, dp):
    return 1.2 * np.clip(U - 5.0, 0.0, 95.0) * np.sqrt(dp / 200.0)


@pytest.mark.parametrize("fs", [100.0, *soaked(10.0)])
@pytest.mark.parametrize("late", [2, *soaked(3, 5)])
def test_the_map_is_as_late_as_the_search_found_it_where_blows_open_the_valve(late, fs):
    rng, N = np.random.default_rng(late), 6_000
    opening = np.repeat(rng.uniform(0.0, 100.0, N // 4) * rng.integers(0, 2, N // 4), 4)
    U, dp = opening, np.repeat(rng.uniform(20.0, 180.0, N // 4), 4)
    Q = np.roll(flow(U, dp), late) + SIGMA * rng.normal(size=N)
    t = np.round(1e9 / fs * np.arange(N)).astype(np.int64)
    _learns(U, dp, Q, t)


@pytest.mark.parametrize("jitter", [0.0, 0.4])
@pytest.mark.parametrize(
    ("dead", "fs"), [(0.15, 10.0), (0.031, 50.0), *soaked((0.07, 20.0), (0.33, 10.0))]
)
def test_a_dead_time_that_ends_between_two_samples_is_found_to_a_part_of_one(dead, fs, jitter):
    rng, N = np.random.default_rng(int(1000 * dead)), 6_000
    t = np.cumsum((1.0 + rng.uniform(-jitter, jitter, N)) / fs)
    turns = np.cumsum(rng.uniform(0.5, 3.0, int(t[-1])))
    openings = rng.uniform(0.0, 100.0, len(turns)) * (rng.random(len(turns)) < 0.8)
    drops = rng.uniform(20.0, 180.0, len(turns))

    def path(t):
        return np.interp(t, turns, openings), np.interp(t, turns, drops)

    Q = flow(*path(t - dead)) + SIGMA * rng.normal(size=N)
    found = _learns(*path(t), Q, np.round(1e9 * t).astype(np.int64))
    assert abs(found - dead) < 0.1 / fs


@pytest.mark.soak  # of a known miss; no lag is found beside the dead times above
@pytest.mark.xfail(
    strict=True, reason="missed: of noise that grows with the flow a lag gains 106 in the peaks"
)
def test_a_lag_is_not_needed_beside_the_best_dead_time():
    row, words = drawn(22045)
    assert "20 Hz" in words
    assert "dead time" in words
    flow_map = FlowMap(U_range=row.U_range, dp_range=row.dp_range)
    state, _ = flow_map.update(flow_map.initial_state(), row.samples[:4_400])
    codes = {finding.code for finding in flow_map.findings(state)}
    assert FindingCode.DEAD_TIME in codes
    assert not codes & {FindingCode.LAG_U, FindingCode.LAG_Q, FindingCode.AVERAGING}


def _learns(U, dp, Q, t):
    """Whether the map is that of the valve and nothing else is found; give the dead time."""
    flow_map = FlowMap()
    samples = Samples.of(t, U, dp, 0 * dp, Q, np.full(len(t), 40.0))
    state, _ = flow_map.update(flow_map.initial_state(), samples)
    assert {finding.code for finding in flow_map.findings(state)} == {FindingCode.DEAD_TIME}
    at = U > 0.0
    predicted, std = flow_map.predict(state, U[at], dp[at], np.full(at.sum(), 40.0))
    error = np.abs(predicted - flow(U[at], dp[at]))
    assert np.sqrt(np.mean(error**2)) < 0.5 * SIGMA
    assert np.mean(error <= 1.96 * std) >= 0.9
    path = member(alone(state), 0).path
    return path[DEAD_U] + path[DEAD_Q]
