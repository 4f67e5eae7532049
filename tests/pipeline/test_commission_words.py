"""What an operator reads of a run: the cause of a refusal, a retreat or an end, with its values."""

from dataclasses import replace

import pytest

from pipeline.test_commission import GOOD, LIMITS, SETTINGS, Course
from valvemap.pipeline.commission_words import in_words
from valvemap.vocabulary.commission import Phase

P2_LIMITED = replace(SETTINGS, limits=replace(LIMITS, p2_range=(5.0, 150.0)))


@pytest.mark.parametrize(
    ("seen", "said"),
    [
        ({"U": 95.0}, "the measured U is outside the permitted range: U 95 %, permitted 10 … 90 %"),
        ({"p1": 90.0, "p2": 50.0}, "beyond its limit: p1 90 bar, permitted 100 … 210 bar"),
        ({"p1": 101.0, "p2": 160.0}, "p1 and p2 may be exchanged: p1 101 bar, p2 160 bar"),
        ({}, ""),
    ],
)
def test_a_refusal_names_what_was_measured(seen, said):
    course = Course(P2_LIMITED, seen=replace(GOOD, **seen))
    state = course.steps(0.1)
    assert (state.phase is Phase.REFUSED) == bool(said)
    assert said in state.why
    assert state.why in in_words(SETTINGS, state, course.seen)


def test_each_value_beyond_its_limit_is_named_while_u_retreats():
    course = Course(P2_LIMITED)
    course.steps(1.0)
    state = course.steps(0.04, p1=215.0, p2=170.0)
    assert state.why.endswith(
        "U retreats: p1 215 bar, permitted 100 … 210 bar; p2 170 bar, permitted 5 … 150 bar"
    )
    assert course.steps(1.0, p1=200.0, p2=100.0).why == ""


def test_an_end_keeps_the_pressure_that_caused_it():
    course = Course()
    course.steps(1.0)
    course.steps(0.04, p1=230.0)
    state = course.steps(2.0, p1=200.0)
    assert state.phase is Phase.ABORTED
    assert state.why == "a pressure is above the limit for an abort: p1 230 bar, limit 220 bar"
