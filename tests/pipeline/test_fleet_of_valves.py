"""Many valves in one call learn what each would learn alone, to the bit."""

from dataclasses import replace

import numpy as np
import pytest

from support.plant import START, as_changes, plant
from valvemap.model.flow_map import FlowMap
from valvemap.model.forgetting import SlidingWindow
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples, Segments, Trace
from valvemap.model.support import Support
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.fleet import Fleet
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.operator_ports import Command
from valvemap.pipeline.quality_gate import QualityGate, SignalLimits
from valvemap.vocabulary.signals import Signal

LENGTHS = (120, 7, 60, 200)
STRICT = QualityGate({**QualityGate().limits, Signal.Q: SignalLimits(0.0, 60.0)})


@pytest.fixture
def plans(plan):
    """Two valves alike, between them one with another gate, then one with other estimators."""
    window = {"RLS": RecursiveLeastSquares(forgetting=SlidingWindow(30)), "Auto": FlowMap()}
    return [
        replace(plan, name="a"),
        replace(plan, name="b", gate=STRICT),
        replace(plan, name="c"),
        replace(plan, name="d", estimators=window),
    ]


def service(plans):
    return Identification(plans, Alignment(AlignmentSettings(), (("T",),) * len(plans)))


def mixed(parts):
    """The changes of several valves as a server sends them: by time, not by valve."""
    changes = [as_changes(samples) for samples in parts]
    moved = [replace(c, item=c.item + np.int32(6 * v)) for v, c in enumerate(changes)]
    every = DataChanges.concatenate(moved)
    return every[np.argsort(every.source_time, kind="stable")]


def known(identification, valve):
    """All that is known of one valve, as bytes."""
    result = identification.results.one(valve)
    lanes = {
        name: (r.theta.tobytes(), r.std.tobytes(), repr((r.t, r.residual, r.status, r.noise_std)))
        for name, r in result.estimators.items()
    }
    return lanes, result.counters


def test_valves_of_several_plans_learn_together_what_they_learn_alone(plans):
    parts = [plant(n, seed=k) for k, n in enumerate(LENGTHS)]
    together, alone = service(plans), service(plans)
    together.do(Command.of("set_forgetting_factor", "c", "RLS", 0.9))
    alone.do(Command.of("set_forgetting_factor", "c", "RLS", 0.9))
    together.do(Command.of("freeze", "a", "RML"))
    alone.do(Command.of("freeze", "a", "RML"))
    changes = mixed(parts)
    for cut in np.array_split(np.arange(len(changes)), 5):
        together.take(changes[slice(cut[0], cut[-1] + 1)])
    for valve, samples in enumerate(parts):
        for part in (samples[:5], samples[5:6], samples[6:]):
            alone.take_samples(valve, part)
    for valve in range(len(plans)):
        lanes, counters = known(together, valve)
        expected, rejected = known(alone, valve)
        assert lanes == expected
        assert {**rejected, "aligned": LENGTHS[valve]} == counters


def test_what_was_handed_out_does_not_change_with_later_samples(plan):
    fleet = Fleet(plan, 2)
    samples = plant(50)
    fleet.take(samples, Segments.one(50))
    before = fleet.lane(0, "RLS")
    theta, cells = before.state.theta.copy(), before.spread.cells.copy()
    fleet.take(plant(50, seed=2, first=50), Segments.one(50))
    np.testing.assert_array_equal(before.state.theta, theta)
    np.testing.assert_array_equal(before.spread.cells, cells)
    assert fleet.lane(0, "RLS").count == 100
    assert fleet.lane(1, "RLS").count == 0


def test_a_batch_tells_which_samples_are_whose():
    align = Alignment(AlignmentSettings(), (("T",),) * 3)
    _, arrived = align.update(align.initial_state(), mixed([plant(3), plant(0), plant(5, seed=1)]))
    assert list(arrived) == [0, 2]
    assert [len(arrived[valve]) for valve in arrived] == [3, 5]
    np.testing.assert_array_equal(arrived[2].Q, plant(5, seed=1).Q)
    with pytest.raises(KeyError):
        arrived[1]
    assert len(Samples.concatenate(list(arrived.values()))) == len(arrived.samples)


def behind_a_slow_meter(n=3_000):
    """A second at 95 % and 10 bar, then a machine that never comes there; Q lags by 200 ms."""
    k = np.arange(n)
    U = np.where(k < 100, 95.0, 40.0 + 30.0 * np.sin(0.021 * k) + 8.0 * np.sin(0.13 * k))
    dp = np.where(k < 100, 10.0, 120.0 + 60.0 * np.sin(0.013 * k + 1.0))
    flow, Q = 0.13 * U * np.sqrt(dp), np.empty(n)
    shown = flow[0]
    for i in range(n):
        shown += (1.0 - np.exp(-0.05)) * (flow[i] - shown)
        Q[i] = shown
    Q += np.random.default_rng(4).normal(0.0, 0.3, n)
    return Samples.of(START + k * 10_000_000, U, dp + 5.0, np.full(n, 5.0), Q)


@pytest.mark.parametrize("piece", [3_000, 700, 13])
def test_a_map_that_begins_anew_behind_a_lag_rests_on_nothing_before(plan, piece):
    fleet = Fleet(replace(plan, estimators={"Auto": FlowMap()}, inverse="Auto"), 1)
    samples = behind_a_slow_meter()
    for start in range(0, len(samples), piece):
        some = samples[start : start + piece]
        fleet.take(some, Segments.one(len(some)))
    lane = fleet.lane(0, "Auto")
    assert lane.estimator.lags(lane.state)[1] == pytest.approx(0.2, abs=0.02)
    since = int(lane.estimator.samples_since(lane.state))
    assert 0 < since < 2_300
    learnt, nothing = samples[len(samples) - since :], np.zeros(since)
    said = Trace(nothing, nothing, nothing, nothing.astype(np.uint8))
    rested_on = Support.none().add(learnt, said)
    assert np.array_equal(lane.support.cells, rested_on.cells)
    beyond = lane.support.distance(np.array([95.0]), np.array([10.0]), np.array([np.nan]))
    assert beyond > 1.0
