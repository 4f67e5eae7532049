"""Raw counts: the signals of a valve come from one kind of card."""

from dataclasses import replace

import numpy as np
import pytest

from valvemap.plant.answers import parse_answers
from valvemap.plant.roles import Role


@pytest.fixture
def counted(plant, moving):
    """The signals of a valve as counts of 27,648, without unit or range."""
    true = moving(seed=3)
    true["U"] = np.clip(true["U"], 0, 100)
    for name, role, span in (("Command", "U", 100.0), ("Inlet pressure", "p1", 400.0),
                             ("Outlet pressure", "p2", 250.0), ("Flow", "Q", 150.0),
                             ("Oil temperature", "T", 100.0)):  # fmt: skip
        plant.add(name, np.round(true[role] / span * 27_648), largest=32_767.0)
    return true


def test_answered_spans_say_which_card_reads_the_others(plant, counted):
    spans = [f"Plant.{role}=0..27648:0..{end}" for role, end in
             (("p1", "400bar"), ("p2", "250bar"), ("Q", "150l/min"))]  # fmt: skip
    (found,) = plant.verdicts(parse_answers((), spans))
    assert found.question is None
    assert found.reading.scales[Role.U].text == "0..27648:0..100%"
    assert found.reading.values[Role.U] == pytest.approx(counted["U"], abs=0.01)


def test_a_small_flow_is_raw_where_the_described_spans_of_the_others_are(plant, moving):
    true = moving(k=1.0)
    for name, role, span, unit in (("Command", "U", 100, "%"), ("Inlet pressure", "p1", 400, "bar"),
                                   ("Outlet pressure", "p2", 250, "bar"),
                                   ("Flow", "Q", 300, "l/min")):  # fmt: skip
        plant.add(name, np.round(true[role] / span * 4_095), largest=32_767.0)
        described = replace(plant.candidates[-1], description=f"0..4095 = 0..{span} {unit}")
        plant.candidates[-1] = described
    (found,) = plant.verdicts()
    assert found.question is None
    assert found.reading.values[Role.Q] == pytest.approx(true["Q"], abs=0.04)


def test_a_span_that_is_none_of_the_usual_ones_can_be_answered(plant, counted):
    (asked,) = plant.verdicts()
    other = dict(one.removeprefix("--scale=Plant.").split("=") for one in asked.question.otherwise)
    assert {"p1", "p2", "Q"} <= set(other)
    most = {"p1": "400", "p2": "250", "Q": "150"}
    spans = [
        f"Plant.{role}={text.replace('LEAST', '0').replace('MOST', most[role])}"
        for role, text in other.items()
        if role in most
    ]
    (found,) = plant.verdicts(parse_answers((), spans))
    assert found.question is None
    assert found.reading.values[Role.Q] == pytest.approx(counted["Q"], abs=0.01)
