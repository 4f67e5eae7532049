"""A flow whose stated unit is wrong contradicts no law: sizes and the plant's units tell."""

import numpy as np
import pytest

from valvemap.plant.answers import parse_answers
from valvemap.plant.reading import Given
from valvemap.plant.roles import Role


def verdict_of(plant, true, unit, name="Flow", given=None):
    for role, label, own in (("U", "Command", "%"), ("p1", "Inlet pressure", "bar"),
                             ("p2", "Outlet pressure", "bar")):  # fmt: skip
        plant.add(label, true[role], own)
    plant.add(name, true["Q"], unit)
    (found,) = plant.verdicts(given)
    return found


@pytest.mark.parametrize("unit", ["m³/h", "l/s"])
def test_l_min_stated_as_a_larger_unit_is_asked_with_both_sizes(plant, moving, unit):
    found = verdict_of(plant, moving(k=4.0), unit)
    assert found.question is not None
    shown = {option.text.split(" in ")[-1]: option.consequence for option in found.question.options}
    assert {"l/min", unit} <= set(shown)
    assert all("Q/√dp up to" in consequence for consequence in shown.values())


def test_an_answer_settles_the_unit(plant, moving):
    given = {"Plant": parse_answers((), ["Plant.Q=m³/h"])["Plant"]}
    found = verdict_of(plant, moving(k=4.0), "m³/h", given=given)
    assert found.question is None
    assert found.reading.scales[Role.Q].text == "m³/h"


@pytest.mark.parametrize(("unit", "k"), [("l/min", 1.0), ("l/min", 40.0), ("m³/h", 0.3)])
def test_a_usual_size_in_the_stated_unit_asks_nothing(plant, moving, unit, k):
    assert verdict_of(plant, moving(k=k), unit).question is None


def test_a_unit_stated_in_the_name_too_asks_nothing(plant, moving):
    assert verdict_of(plant, moving(k=2.0), "m³/h", name="Flow [m³/h]").question is None


def test_a_flow_that_stands_still_has_no_size(plant, moving):
    true = moving()
    rng = np.random.default_rng(1)
    still = {**true, "U": 0 * true["U"], "Q": rng.normal(0.0, 0.02, len(true["Q"]))}
    assert verdict_of(plant, still, "l/min", given={"Plant": Given()}).question is None
