"""An integer whose factor stands in a node beside it."""

import numpy as np
import pytest

from valvemap.pipeline.units import unit_of
from valvemap.plant.assignments import scales_of
from valvemap.plant.candidates import Candidate
from valvemap.plant.companions import with_companions
from valvemap.plant.reading import Given, Record
from valvemap.plant.roles import Role

BAR = unit_of("bar")
COUNTS = np.array([17_950.0, 18_020.0])


def read(name: str, number: float, largest: float | None = 32_767.0) -> list[float]:
    """Return the first pressure in bar of each reading of a value beside a node of this name."""
    value = Candidate("v", ("PT1", "Value"), BAR, largest=largest)
    own = with_companions([value, Candidate("c", ("PT1", name))])[0]
    record = Record({"v": COUNTS, "c": np.full(2, number)})
    found = sorted(scales_of(Role.P1, own, record, Given()), key=lambda one: -one.prior)
    return [round(float(one(COUNTS, Role.P1)[0]), 3) for one in found]


@pytest.mark.parametrize(
    ("name", "number"), [("Scale", 0.01), ("Divisor", 100.0), ("Decimals", 2.0), ("Faktor", 0.01)]
)
def test_an_integer_is_multiplied_by_the_factor_beside_it(name, number):
    found = read(name, number)
    assert found[0] == 179.5
    assert 17_950.0 in found  # or it is not, which the values may tell


@pytest.mark.parametrize(("name", "number"), [("Scale", 1.0), ("Scale", 0.0), ("Count", 0.01)])
def test_a_node_that_means_no_factor_changes_nothing(name, number):
    assert read(name, number)[0] == 17_950.0


def test_a_floating_value_is_in_its_unit_already():
    assert read("Scale", 0.01, largest=None) == [17_950.0]


def test_a_factor_that_moves_is_none():
    value = Candidate("v", ("PT1", "Value"), BAR, largest=32_767.0)
    own = with_companions([value, Candidate("c", ("PT1", "Scale"))])[0]
    record = Record({"v": COUNTS, "c": np.array([0.01, 0.02])})
    assert scales_of(Role.P1, own, record, Given())[0].measure.raw is None
