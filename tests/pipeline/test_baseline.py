"""The map of the new valve is approved, kept over restarts, compared with, gone back to."""

import numpy as np
import pytest

from support.plant import as_changes, plant
from valvemap.errors import CommandRejected
from valvemap.model.samples import Samples
from valvemap.pipeline.baseline import Baseline
from valvemap.pipeline.ports import Command

VALVE = "Valvistor"


def worn(samples):
    """The same valve that passes a tenth less."""
    s = samples
    return Samples.of(t=s.t, U=s.U, p1=s.p1, p2=s.p2, Q=0.9 * s.Q, T=s.T)


@pytest.fixture
def learnt(identification):
    identification.take(as_changes(plant(600)))
    return identification


def test_nothing_is_approved_before_something_is_known(identification):
    with pytest.raises(CommandRejected, match="not one to build on"):
        identification.do(Command.of("approve", VALVE))
    for wanted in (
        lambda: identification.do(Command.of("roll_back", VALVE)),
        lambda: identification.compare(VALVE, "RLS"),
    ):
        with pytest.raises(CommandRejected, match="has no baseline"):
            wanted()


def test_a_version_has_number_time_and_hash(learnt):
    learnt.do(Command.of("approve", VALVE))
    first = learnt.baseline(0)
    assert first.number == 1
    assert first.t == plant(600).t[-1]
    assert first.version == f"1-{first.digest[:12]}"
    assert len(first.digest) == 64
    learnt.do(Command.of("approve", VALVE))
    assert learnt.baseline(0).version.startswith("2-")
    assert learnt.baseline(0).digest == first.digest  # nothing was learnt in between
    (results,) = learnt.results.of([0])
    assert results.baselines[0].version == learnt.baseline(0).version


def test_a_map_is_compared_with_the_approved_one(learnt):
    learnt.do(Command.of("approve", VALVE))
    assert learnt.compare(VALVE, "RLS").largest == 0.0
    learnt.do(Command.of("reset", VALVE, "RLS"))
    learnt.take_samples(0, worn(plant(3000, seed=4, first=600)))
    found = learnt.compare(VALVE, "RLS")
    expected = -0.1 * (3 + 0.1 * found.U * np.sqrt(found.dp) - 0.02 * found.dp)
    assert found.largest == pytest.approx(expected, rel=0.1)
    assert found.points > 100
    with pytest.raises(CommandRejected, match="no estimator 'Auto'"):
        learnt.compare(VALVE, "Auto")


def test_the_approved_map_answers_as_it_did_when_it_was_approved(learnt):
    point = (50.0, 100.0, 40.0)
    with pytest.raises(CommandRejected, match="no baseline"):
        learnt.predict_approved(VALVE, "RLS", *point)
    learnt.do(Command.of("approve", VALVE))
    then = learnt.predict(VALVE, "RLS", *point)[:2]  # places visited again are not approved
    assert learnt.predict_approved(VALVE, "RLS", *point)[:2] == then
    learnt.do(Command.of("reset", VALVE, "RLS"))
    learnt.take_samples(0, worn(plant(3000, seed=4, first=600)))
    assert learnt.predict_approved(VALVE, "RLS", *point)[:2] == then
    assert learnt.predict(VALVE, "RLS", *point)[:2] != then
    learnt.do(Command.of("approve", VALVE))
    assert learnt.predict_approved(VALVE, "RLS", *point)[:2] != then


def test_going_back_is_to_the_last_bit(learnt):
    theta = {name: lane.state.to_bytes("k") for name, lane in learnt.valves.state(0).lanes.items()}
    learnt.do(Command.of("approve", VALVE))
    learnt.take_samples(0, worn(plant(300, seed=4, first=600)))
    learnt.do(Command.of("roll_back", VALVE))
    assert theta == {
        name: lane.state.to_bytes("k") for name, lane in learnt.valves.state(0).lanes.items()
    }


def test_another_valve_starts_from_nothing(learnt):
    learnt.do(Command.of("approve", VALVE))
    learnt.do(Command.of("replace_valve", VALVE))
    assert learnt.baseline(0) is None
    assert learnt.results.one(0).estimators["RLS"].sample_count == 0
    learnt.take_samples(0, plant(600, first=600))
    learnt.do(Command.of("approve", VALVE))
    assert learnt.baseline(0).number == 2


def test_a_restart_keeps_the_approved_map_and_that_there_is_none(learnt, fresh):
    learnt.do(Command.of("approve", VALVE))
    again = fresh()
    _, refused = again.restore([*learnt.states.checkpoints(), *learnt.states.memories()])
    assert not refused
    assert again.baseline(0) == learnt.baseline(0)
    again.do(Command.of("replace_valve", VALVE))
    third = fresh()
    third.restore([*again.states.checkpoints(), *again.states.memories()])
    assert third.baseline(0) is None
    third.take_samples(0, plant(600))
    third.do(Command.of("approve", VALVE))
    assert third.baseline(0).number == 2


def test_a_damaged_one_is_not_believed(learnt):
    learnt.do(Command.of("approve", VALVE))
    packed = bytearray(learnt.baseline(0).to_bytes())
    packed[-1000] ^= 1
    with pytest.raises(ValueError, match="hash"):
        Baseline.from_bytes(bytes(packed))
