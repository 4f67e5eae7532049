"""Absolute pressures beside gauge pressures: converted where they say so, else asked."""

import numpy as np
import pytest

from valvemap.plant.answers import of_valve, parse_answers
from valvemap.plant.roles import Role

ATMOSPHERE = 1.01325


def valve(plant, true, p1=("Inlet pressure", "bar"), p2=("Outlet pressure", "bar")):
    """Two gauges, each with (name, unit's text); the unit is told by text alone."""
    plant.add("Command", true["U"], "%")
    plant.add(p1[0], true["p1"], symbol=p1[1])
    plant.add(p2[0], true["p2"], symbol=p2[1])
    plant.add("Flow", true["Q"], "l/min")


@pytest.mark.parametrize("stated", ["bar(a)", "bara", "bar abs.", "BAR(A)"])
def test_an_absolute_pressure_beside_a_gauge_is_converted(plant, moving, stated):
    true = moving()
    absolute = {**true, "p1": true["p1"] + ATMOSPHERE}
    valve(plant, absolute, ("Inlet pressure", stated), ("Outlet pressure", "bar Ü"))
    (verdict,) = plant.verdicts()
    assert verdict.question is None
    assert verdict.reading.values[Role.P1] == pytest.approx(true["p1"])


def test_psi_absolute_in_both_is_converted_in_both(plant, moving):
    true, psi = moving(), 14.503773773
    both = {**true, **{p: (true[p] + ATMOSPHERE) * psi for p in ("p1", "p2")}}
    valve(plant, both, ("Inlet pressure", "psia"), ("Outlet pressure", "psi(a)"))
    (verdict,) = plant.verdicts()
    assert verdict.question is None
    assert verdict.reading.values[Role.P2] == pytest.approx(true["p2"], abs=1e-6)


def test_a_word_in_the_name_or_the_description_says_absolute(plant, moving):
    true = moving()
    absolute = {**true, "p1": true["p1"] + ATMOSPHERE}
    valve(plant, absolute, ("p1 absolut", "bar"), ("p2 relativ, Überdruck", "bar"))
    (verdict,) = plant.verdicts()
    assert verdict.question is None
    assert verdict.reading.values[Role.P1] == pytest.approx(true["p1"])


def test_one_absolute_beside_one_that_says_nothing_is_asked_and_each_answer_is_obeyed(
    plant, moving
):
    true = moving()
    both = {**true, "p1": true["p1"] + ATMOSPHERE, "p2": true["p2"] + ATMOSPHERE}
    valve(plant, both, ("Inlet pressure", "bar(a)"))
    (asked,) = plant.verdicts()
    assert "against the atmosphere, or absolute?" in asked.question.about
    lowest = {}
    for option in asked.question.options:
        given = parse_answers(
            [a.removeprefix("--signal=") for a in option.answers if "--signal" in a],
            [a.removeprefix("--scale=") for a in option.answers if "--scale" in a],
        )
        (obeyed,) = plant.verdicts({asked.valve: of_valve(given, asked.valve)})
        assert obeyed.question is None
        unit = obeyed.reading.scales[Role.P2].text
        lowest[unit] = float(obeyed.reading.values[Role.P2].min())
    assert lowest["bar"] - lowest["bar(a)"] == pytest.approx(ATMOSPHERE)
    assert lowest["bar(a)"] == pytest.approx(true["p2"].min())


def test_a_gauge_without_pressure_shows_that_it_is_none_against_vacuum(plant, moving):
    true = moving()
    tank = {**true, "p1": true["p1"] + ATMOSPHERE, "p2": 0.02 + 0 * true["p2"]}
    tank["Q"] = 4 * (true["U"] / 100) ** 1.2 * np.sqrt(true["p1"])
    valve(plant, tank, ("Inlet pressure", "bar(a)"), ("Tank pressure", "bar"))
    (verdict,) = plant.verdicts()
    assert verdict.question is None


def test_at_rest_one_that_shows_the_atmosphere_beside_one_that_shows_nothing_is_asked(
    plant, moving
):
    true, rng = moving(), np.random.default_rng(1)
    n = len(true["t"])
    still = {"U": 0 * true["U"], "Q": rng.normal(0, 0.05, n)}
    still |= {"p1": 1.01 + rng.normal(0, 0.003, n), "p2": rng.normal(0, 0.003, n)}
    valve(plant, still)
    (asked,) = plant.verdicts()
    assert asked.question.about.startswith("p1: against the atmosphere, or absolute?")


def test_a_difference_has_no_reference(plant, moving):
    true = moving()
    plant.add("Command", true["U"], "%")
    plant.add("Differential pressure", true["p1"] - true["p2"], symbol="bara")
    plant.add("Flow", true["Q"], "l/min")
    (verdict,) = plant.verdicts()
    assert verdict.reading.values[Role.DP] == pytest.approx(true["p1"] - true["p2"])
