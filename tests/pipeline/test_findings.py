"""Causes that an estimator finds reach the results of its valve."""

import numpy as np

from valvemap.model.flow_map import FlowMap
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples, Segments
from valvemap.pipeline.fleet import Fleet
from valvemap.pipeline.quality_gate import QualityGate
from valvemap.pipeline.valve_state import ValvePlan
from valvemap.vocabulary.findings import FindingCode


def with_play(N, play):
    """Ramps of U at 100 Hz; the spool follows behind a play."""
    t, spool = np.arange(N), np.empty(N)
    U = 50.0 + 45.0 * np.sin(2.0 * np.pi * t / 900.0) * np.sin(2.0 * np.pi * t / 5_300.0)
    dp = 100.0 + 80.0 * np.sin(2.0 * np.pi * t / 1_700.0)
    x = U[0]
    for i in range(N):
        x = min(max(x, U[i] - play / 2.0), U[i] + play / 2.0)
        spool[i] = x
    Q = 0.14 * spool * np.sqrt(dp) + np.random.default_rng(1).normal(0.0, 0.4, N)
    return Samples.of(t * 10_000_000, U, dp, 0.0 * dp, Q, 40.0 + 0.0 * U)


def test_play_is_found_by_the_model_beside_an_estimator_that_looks_for_nothing():
    estimators = {"RLS": RecursiveLeastSquares(), "FlowMap": FlowMap()}
    fleet = Fleet(ValvePlan("V1", QualityGate(), estimators, "RLS"), 1)
    assert fleet.findings(0) == ()
    fleet.take(with_play(12_000, 4.0), Segments.one(12_000))
    found = fleet.findings(0)
    assert found[0].code == FindingCode.PLAY
    assert found[0].probability > 0.9
    assert list(found) == sorted(found, key=lambda one: -one.probability)
