"""Estimators that have learnt the same share what their maps rest on, and nobody can tell."""

from dataclasses import replace

import numpy as np
import pytest

from support.plant import plant
from valvemap.model.samples import Samples, Segments
from valvemap.model.support import Support
from valvemap.pipeline.fleet import Fleet
from valvemap.pipeline.shared_support import SharedSupport
from valvemap.pipeline.valve_state import fresh_lane
from valvemap.vocabulary.statuses import Status

E, M, N = 4, 3, 60


def bits(support):
    return support.cells.tobytes(), support.fit.tobytes(), support.ranges.tobytes()


def of_each(rng):
    """Samples of M valves, and what E estimators made of them: mostly the same."""
    U, dp = rng.uniform(0, 100, M * N), rng.uniform(0, 200, M * N)
    samples = Samples.of(np.arange(M * N), U, dp, 0 * dp, U, np.full(M * N, 40.0))
    status = np.zeros((E, M * N), np.uint8)
    status[:, rng.random(M * N) < 0.1] = Status.REJECTED
    if rng.random() < 0.5:
        e, m = rng.integers(E), rng.integers(M)
        status[e, m * N : (m + 1) * N][rng.random(N) < 0.2] = Status.HELD
    edges = N * np.arange(M + 1)
    return samples, status, Segments(np.arange(M), edges[:-1], edges[1:])


@pytest.mark.parametrize("seed", range(5))
def test_each_rests_on_what_it_would_rest_on_alone(seed):
    rng, nothing = np.random.default_rng(seed), Support.none()
    shared = SharedSupport(nothing, E, M)
    alone = [nothing.of_many(M) for _ in range(E)]
    for _ in range(12):
        samples, status, segments = of_each(rng)
        own = [segments] * E
        if rng.random() < 0.3:  # a map that began anew in the middle
            e, m = int(rng.integers(E)), int(rng.integers(M))
            later = segments.starts.copy()
            later[m] += N // 2
            own[e] = segments._replace(starts=later)
            shared.put(e, m, nothing)
            alone[e].put(m, nothing)
        if rng.random() < 0.3:  # a state that was kept
            e, other, m = int(rng.integers(E)), int(rng.integers(E)), int(rng.integers(M))
            shared.put(e, m, shared.one(other, m))
            alone[e].put(m, alone[other].one(m))
        shared.learn(samples, list(zip(status, own, strict=True)), segments)
        for e in range(E):
            alone[e].learn(samples, status[e], own[e])
        for e in range(E):
            for m in range(M):
                assert bits(shared.one(e, m)) == bits(alone[e].one(m))
    assert M < shared.rows <= E * M


def test_all_share_until_one_parts_and_again_once_all_are_the_same(plan):
    fleet, samples = Fleet(plan, 2), plant(200)
    both = Segments(np.array([0, 1]), np.array([0, 120]), np.array([120, 200]))
    fleet.take(samples, both)
    shared = fleet._support
    assert shared.rows == 2
    fleet.put(1, "RLS", replace(fleet.lane(1, "RLS"), frozen=True))
    assert shared.rows == 2
    fleet.take(samples, both)
    assert shared.rows == 3
    learnt = fleet.lane(1, "RML")
    fleet.put(1, "RLS", replace(fleet.lane(1, "RLS"), support=learnt.support))
    assert shared.rows == 2
    for name, estimator in plan.estimators.items():
        fleet.put(1, name, fresh_lane(estimator, learnt.support.forgotten()))
    assert shared.rows == 2
    assert len(fleet.lane(1, "RML").support.boxes) == 0
    assert len(fleet.lane(0, "RML").support.boxes) > 0


def test_columns_that_are_written_are_taken_up():
    shared, one = SharedSupport(Support.none(), E, M), Support.none()
    one.cells[7] = 3
    columns = [shared.columns(e) for e in range(E)]
    columns[2]["seen"][1] = one.cells
    for e in range(E):
        shared.take_up(e, columns[e])
    assert shared.rows == M + 1
    assert [shared.one(e, 1).cells.any() for e in range(E)] == [False, False, True, False]
    assert not shared.one(2, 0).cells.any()
