"""A dead time of the meter where U and Δp move by much within a sample."""

import numpy as np
import pytest

from support.missed import missed
from valvemap.model.flow_map import FlowMap
from valvemap.model.samples import Samples
from valvemap.vocabulary.findings import FindingCode

SIGMA = 0.4


def flow(U, dp):
    return 1.2 * np.clip(U - 5.0, 0.0, 95.0) * np.sqrt(dp / 200.0)


@pytest.mark.parametrize(
    ("late", "fs"),
    [
        (2, 10.0),
        pytest.param(3, 10.0, marks=missed(".75 σ off")),
        (5, 10.0),
        (2, 100.0),
        (3, 100.0),
        (5, 100.0),
    ],
)
def test_the_map_is_as_late_as_the_search_found_it_where_blows_open_the_valve(late, fs):
    rng, N = np.random.default_rng(late), 6_000
    opening = np.repeat(rng.uniform(0.0, 100.0, N // 4) * rng.integers(0, 2, N // 4), 4)
    U, dp = opening, np.repeat(rng.uniform(20.0, 180.0, N // 4), 4)
    Q = np.roll(flow(U, dp), late) + SIGMA * rng.normal(size=N)
    t = np.round(1e9 / fs * np.arange(N)).astype(np.int64)
    flow_map = FlowMap()
    state, _ = flow_map.update(
        flow_map.initial_state(), Samples.of(t, U, dp, 0 * dp, Q, np.full(N, 40.0))
    )
    assert FindingCode.DEAD_TIME in {finding.code for finding in flow_map.findings(state)}
    at = U > 0.0
    predicted, std = flow_map.predict(state, U[at], dp[at], np.full(at.sum(), 40.0))
    error = np.abs(predicted - flow(U[at], dp[at]))
    assert np.sqrt(np.mean(error**2)) < 0.5 * SIGMA
    assert np.mean(error <= 1.96 * std) >= 0.9
