"""The map of the new valve is approved, kept over restarts, compared with, gone back to."""

from dataclasses import make_dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest

from support.plant import as_changes, plant
from valvemap.errors import CommandRejected
from valvemap.model.estimator import State
from valvemap.model.samples import Samples
from valvemap.pipeline.baseline import KEY, Baseline, _digest, _Kept
from valvemap.pipeline.operator_ports import Command
from valvemap.vocabulary.statuses import Status

VALVE = "Valvistor"


def worn(samples):
    """The same valve that passes a tenth less."""
    s = samples
    return Samples.of(t=s.t, U=s.U, p1=s.p1, p2=s.p2, Q=0.9 * s.Q, T=s.T)


def _of_version_2(kept):
    """The same record as it was stored without statuses."""
    names = [name for name in vars(kept) if name != "statuses"]
    version = {"__annotations__": {"state_version": ClassVar[int]}, "state_version": 2}
    kind = make_dataclass(
        "_Kept", [(name, Any) for name in names], bases=(State,), namespace=version, frozen=True
    )
    return kind(**{name: getattr(kept, name) for name in names})


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


def test_the_approved_map_keeps_its_status_over_what_follows_and_over_a_restart(learnt, fresh):
    point, nowhere = (50.0, 100.0, 40.0), (50.0, 100.0, 300.0)
    then = learnt.predict(VALVE, "RLS", *point)[2]
    assert then is Status.OK
    learnt.do(Command.of("approve", VALVE))
    learnt.do(Command.of("reset", VALVE, "RLS"))
    again = fresh()
    again.restore([*learnt.states.checkpoints(), *learnt.states.memories()])
    for one in (learnt, again):
        assert one.predict(VALVE, "RLS", *point)[2] is Status.WARMING_UP
        assert one.predict_approved(VALVE, "RLS", *point)[2] is then
        assert one.predict_approved(VALVE, "RLS", *nowhere)[2] is Status.EXTRAPOLATING


def test_a_record_of_before_statuses_were_stored_is_taken_as_approved(learnt):
    learnt.do(Command.of("approve", VALVE))
    new = learnt.baseline(0)
    old = Baseline(new.number, new.t, _digest(new.t, new.states, {}), new.states, new.keys)
    kept = _Kept.from_bytes(old.to_bytes(), KEY)
    packed = replace(_of_version_2(kept), digest=np.array(old.digest)).to_bytes(KEY)
    assert Baseline.from_bytes(packed) == old
    estimator = learnt.plans[0].estimators["RLS"]
    assert old.lane("RLS", estimator).status is Status.OK


def test_a_status_that_is_none_is_not_believed(learnt):
    learnt.do(Command.of("approve", VALVE))
    kept = _Kept.from_bytes(learnt.baseline(0).to_bytes(), KEY)
    for statuses in (kept.statuses + 100, kept.statuses[:1], 1 - np.minimum(kept.statuses, 1)):
        with pytest.raises(ValueError, match=r"not a baseline|hash"):
            Baseline.from_bytes(replace(kept, statuses=statuses).to_bytes(KEY))


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
