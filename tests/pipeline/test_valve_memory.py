"""What is stored of a valve beside its estimators' states."""

from dataclasses import fields, make_dataclass, replace
from typing import Any

import numpy as np
import pytest

from valvemap.model.estimator import State, StateMismatchError
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.arrivals import ArrivalsOfValve
from valvemap.pipeline.clock_steps import Known
from valvemap.pipeline.quality_gate import QualityGate
from valvemap.pipeline.valve_memory import LaneNotes, ValveMemory, _Kept

KEY = "key"
GATE = QualityGate()
ALIGNMENT = Alignment(AlignmentSettings(), optional=((),))


def memory(source_started):
    waiting = ALIGNMENT.of(ALIGNMENT.initial_state(), 0)
    rest = {
        "t": 1,
        "T": 40.0,
        "demand": (np.nan, np.nan),
        "notes": {"RLS": LaneNotes(0, np.nan, np.nan, -1)},
    }
    known = Known(np.array([7, 8, 6]), np.array([1, -2, 3]))
    return ValveMemory(
        GATE.initial_state(1), ArrivalsOfValve(waiting, source_started, known), **rest
    )


def restored(packed):
    return ValveMemory.from_bytes(packed, KEY, GATE, ALIGNMENT)


def test_the_start_of_its_source_and_the_samples_around_a_step_of_its_clock_are_kept():
    found = restored(memory(7).to_bytes(KEY)).arrivals
    assert found.source_started == 7
    assert [array.tolist() for array in found.known] == [[7, 8, 6], [1, -2, 3]]


def test_a_memory_of_version_2_does_not_know_them():
    kept = _Kept.from_bytes(memory(7).to_bytes(KEY), KEY)
    new = {"source_started", "known_times", "known_digests"}
    names = [field.name for field in fields(_Kept) if field.name not in new]
    old = make_dataclass("_Kept", [(name, Any) for name in names], bases=(State,), frozen=True)
    packed = old(**{name: getattr(kept, name) for name in names}).to_bytes(KEY)
    found = restored(packed).arrivals
    assert (found.source_started, len(found.known.times)) == (0, 0)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("source_started", np.array(0.5)),
        ("known_digests", np.zeros(2, np.int64)),
        ("known_times", np.zeros(5000, np.int64)),
    ],
)
def test_what_cannot_be_is_refused(name, wrong):
    kept = _Kept.from_bytes(memory(7).to_bytes(KEY), KEY)
    with pytest.raises(StateMismatchError, match=name.partition("_")[0]):
        restored(replace(kept, **{name: wrong}).to_bytes(KEY))
