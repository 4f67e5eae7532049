"""What is stored of a valve beside its estimators' states."""

from dataclasses import fields, make_dataclass, replace
from typing import Any

import numpy as np
import pytest

from valvemap.model.estimator import State, StateMismatchError
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
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
    return ValveMemory(GATE.initial_state(1), waiting, source_started, **rest)


def restored(packed):
    return ValveMemory.from_bytes(packed, KEY, GATE, ALIGNMENT)


def test_the_start_of_its_source_is_kept():
    assert restored(memory(7).to_bytes(KEY)).source_started == 7


def test_a_memory_of_version_2_does_not_know_it():
    kept = _Kept.from_bytes(memory(7).to_bytes(KEY), KEY)
    names = [field.name for field in fields(_Kept) if field.name != "source_started"]
    old = make_dataclass("_Kept", [(name, Any) for name in names], bases=(State,), frozen=True)
    packed = old(**{name: getattr(kept, name) for name in names}).to_bytes(KEY)
    assert restored(packed).source_started == 0


def test_a_start_that_is_no_time_is_refused():
    kept = _Kept.from_bytes(memory(7).to_bytes(KEY), KEY)
    with pytest.raises(StateMismatchError, match="source_started"):
        restored(replace(kept, source_started=np.array(0.5)).to_bytes(KEY))
