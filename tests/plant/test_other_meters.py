"""Two meters of one flow that disagree are asked: the orifice law fits both."""

import numpy as np
import pytest

from valvemap.pipeline.units import unit_of
from valvemap.plant.candidates import Candidate
from valvemap.plant.grouping import group
from valvemap.plant.reading import Record
from valvemap.plant.verdict import judge

T = np.arange(0.0, 20.0, 0.05)
NOISE = np.random.default_rng(5).normal(0.0, 0.1, (2, len(T)))


def judged(second, name="Flow meter 2", first="Flow meter 1"):
    U = 50 + 40 * np.sin(1.3 * T)
    p2 = 60 + 30 * np.sin(0.7 * T)
    Q = 0.06 * U * np.sqrt(180 - p2)
    rows = {
        "Command": (U, "%"),
        "Inlet pressure": (np.full(len(T), 180.0) + NOISE[0], "bar"),
        "Outlet pressure": (p2, "bar"),
        first: (Q + NOISE[1], "l/min"),
        name: (second(Q), "l/min"),
    }
    found = [Candidate(n, ("Bench", n), unit_of(unit)) for n, (_, unit) in rows.items()]
    record = Record({n: values for n, (values, _) in rows.items()}, 0.05)
    (one,) = group(found)
    return judge(one, record)


@pytest.mark.parametrize("factor", [0.5, 0.93, 1.07])
def test_meters_that_differ_by_a_factor_are_asked_by_name(factor):
    verdict = judged(lambda Q: factor * Q)
    assert verdict.question is not None
    assert "Flow meter 1" in verdict.question.about
    assert "Flow meter 2" in verdict.question.about
    nodes = {answer for one in verdict.question.options for answer in one.answers}
    assert {f"--signal=Bench.Q=Flow meter {n}" for n in (1, 2)} <= nodes


@pytest.mark.parametrize(("first", "second"), [("Flow A", "Flow B"), ("Flow B", "Flow A")])
def test_meters_with_letters_are_two_meters_where_no_pressure_is_that_of_a_port(first, second):
    verdict = judged(lambda Q: 0.6 * Q, second, first)
    assert verdict.question is not None
    nodes = {answer for one in verdict.question.options for answer in one.answers}
    assert {f"--signal=Bench.Q={name}" for name in (first, second)} <= nodes


def test_one_that_is_named_as_computed_asks_nothing():
    assert judged(lambda Q: 1.07 * Q, "Calculated flow").question is None
