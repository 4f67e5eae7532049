"""Which valves are shown, and how others follow them over a reload."""

from dataclasses import replace

import numpy as np
import pytest

from valvemap.opcua_results.result_slots import ValveSlots
from valvemap.pipeline.results import ValveDescription

BOOM, BUCKET, STICK = (ValveDescription(name, ()) for name in ("Boom", "Bucket", "Stick"))
COUNTED = replace(BUCKET, counters=("late", "gaps"))


def slots_of(slots, *numbers):
    return slots.of(np.array(numbers)).tolist()


def test_at_first_the_operators_numbers_are_the_slots():
    slots = ValveSlots([BOOM, BUCKET])
    assert slots_of(slots, 0, 1) == slots.every.tolist() == [0, 1]
    assert slots.names == ["Boom", "Bucket"]
    assert slots.shown == [BOOM, BUCKET]


def test_a_valve_that_stays_keeps_its_slot_whatever_its_number():
    slots = ValveSlots([BOOM, BUCKET])
    change = slots.follow([STICK, BUCKET])
    assert slots_of(slots, 0, 1) == [2, 1]
    assert (slots.number("Stick"), slots.number("Bucket")) == (0, 1)
    assert (change.gone, list(change.came), change.kept.tolist()) == ({"Boom"}, [STICK], [1])


def test_no_slot_is_used_twice():
    slots = ValveSlots([BOOM])
    slots.follow([])
    slots.follow([BOOM])
    assert len(slots) == 2
    assert slots.by_name.get("Boom") == 1


def test_a_valve_that_is_described_otherwise_goes_and_comes():
    slots = ValveSlots([BOOM, BUCKET])
    change = slots.follow([BOOM, COUNTED])
    assert (change.gone, list(change.came)) == ({"Bucket"}, [COUNTED])
    assert slots.shown == [BOOM, COUNTED]
    assert slots[1] == BUCKET
    assert slots[2] == COUNTED


def test_what_was_shown_and_is_are_said_whole():
    slots = ValveSlots([BOOM, BUCKET])
    change = slots.follow([STICK, BOOM])
    assert list(change.before) == [BOOM, BUCKET]
    assert list(change.after) == [STICK, BOOM]


def test_a_valve_that_is_not_shown_has_no_slot_and_no_number():
    slots = ValveSlots([BOOM, BUCKET])
    slots.follow([BUCKET])
    assert slots.by_name.get("Boom") is None
    with pytest.raises(KeyError):
        slots.number("Boom")


def test_the_most_counters_of_any_valve_are_known():
    assert ValveSlots([]).most_counters == 0
    assert ValveSlots([BOOM, COUNTED]).most_counters == 2
