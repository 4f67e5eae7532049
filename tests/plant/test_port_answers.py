"""A valve with four ports, wrong ranges, units or direction: each answer, obeyed, works."""

from dataclasses import replace

import numpy as np
import pytest

from valvemap.plant.answers import parse_answers
from valvemap.plant.reading import Given
from valvemap.plant.roles import Role


@pytest.fixture
def servo(plant, moving):
    """One line metered; U in V, whose sign opens PA, and the range of U and QA."""

    def build(sign=1.0, bounds=(-10.0, 10.0), most=200.0, unit="l/min"):
        true = moving()
        t = true["t"]
        U = 80 * np.sin(1.3 * t) + 10 * np.sin(3 * t)
        pA, pB, pT = 60 + 20 * np.sin(0.8 * t), 50 - 20 * np.sin(0.8 * t), 3 + 0 * t
        QA = 0.05 * U * np.sqrt(np.where(U > 0, true["p1"] - pA, pA - pT))
        plant.add("Command", sign * U / 10, "V", bounds)
        for name, values in (("pP", true["p1"]), ("pT", pT), ("pA", pA), ("pB", pB)):
            plant.add(name, values, "bar")
        plant.add("QA", QA, unit, (0.0, most))
        return U

    return build


def answered(plant, option):
    signals = [a.removeprefix("--signal=") for a in option.answers if a.startswith("--signal=")]
    scales = [a.removeprefix("--scale=") for a in option.answers if a.startswith("--scale=")]
    given = parse_answers(signals, scales, ports=True)["Plant"]
    given = replace(given, ports="--ports=Plant" in option.answers)
    (again,) = plant.verdicts({"Plant": given})
    return again


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_wrong_ranges_and_a_command_the_other_way_round_are_asked_and_answered(plant, servo, sign):
    U = servo(sign, bounds=(0.0, 10.0), most=5.0)
    (asked,) = plant.verdicts({"Plant": Given(ports=True)})
    assert "U leaves its range" in asked.question.about
    assert "QA leaves its range" in asked.question.about
    (option,) = asked.question.options
    assert ("U > 0 opens PB and AT" in option.text) is (sign < 0)
    whole = answered(plant, option)
    assert whole.question is None
    assert whole.has_ports
    assert whole.reading.values[Role.U] == pytest.approx(U)


def test_the_same_is_an_option_where_nobody_asked_for_all_edges(plant, servo):
    U = servo(-1.0)
    (asked,) = plant.verdicts()
    every, one = asked.question.options
    assert "U > 0 opens PB and AT: all edges" in every.text
    assert answered(plant, every).question is None
    single = answered(plant, one)
    assert single.question is None
    names = {str(role): node.path[-1] for role, node in single.reading.nodes.items()}
    assert names == {"U": "Command", "p1": "pP", "p2": "pA", "Q": "QA"}
    assert single.reading.values[Role.U][U > 0] == pytest.approx(U[U > 0])


def test_units_that_nothing_states_are_shown_with_their_values(plant, servo):
    servo(unit=None)
    (asked,) = plant.verdicts({"Plant": Given(ports=True)})
    assert "QA: nothing states the unit" in asked.question.about
    first = asked.question.options[0]
    assert "QA (QA) " in first.consequence
    assert answered(plant, first).question is None


def test_elements_named_by_the_letters_of_the_ports_are_those_of_one_valve(plant, servo):
    servo()
    ports = {"pP": "P [bar]", "pT": "T [bar]", "pA": "A [bar]", "pB": "B [bar]"}
    plant.candidates = [
        replace(one, path=("Plant", "Pressures", ports[one.path[-1]]), unit=None)
        if one.path[-1] in ports
        else one
        for one in plant.candidates
    ]
    (asked,) = plant.verdicts()
    assert "four ports" in asked.question.about
    assert answered(plant, asked.question.options[0]).question is None
