"""The configuration that `connect` writes of a valve covers the U that was seen."""

import tomllib

import numpy as np
import pytest

from valvemap.app.connect_toml import of_valve
from valvemap.config.models import Config
from valvemap.pipeline.units import unit_of
from valvemap.plant.candidates import Candidate
from valvemap.plant.grouping import group
from valvemap.plant.reading import Record
from valvemap.plant.verdict import judge

NAMES = {"U": ("Command", "%"), "p1": ("Pressure upstream", "bar")}
NAMES |= {"p2": ("Pressure downstream", "bar"), "Q": ("Flow", "l/min")}


def written(U):
    t = 0.05 * np.arange(400)
    p2 = 60 + 40 * np.sin(0.37 * t)
    noise = np.random.default_rng(1).normal(0, 0.1, len(t))
    values = {"U": U(t), "p1": 190 + noise, "p2": p2}
    values["Q"] = 0.1 * np.abs(values["U"]) * np.sqrt(190 - p2) + noise
    nodes = [
        Candidate(f"ns=2;s={name}", ("Plant", "V1", name), unit_of(unit))
        for name, unit in NAMES.values()
    ]
    record = Record({f"ns=2;s={NAMES[s][0]}": x for s, x in values.items()}, 0.05)
    (verdict,) = [judge(one, record) for one in group(nodes)]
    assert verdict.question is None
    (valve,) = Config.model_validate(tomllib.loads(of_valve(verdict))).valves
    return valve


@pytest.mark.parametrize("U", [lambda t: -50 - 45 * np.sin(t), lambda t: -30 - 45 * np.sin(t)])
def test_a_valve_whose_U_is_negative_gets_a_range_that_covers_it(U):
    valve = written(U)
    assert valve.U_range_percent == (-100.0, 100.0)
    assert all(one.any_U_range for one in valve.estimators)


def test_a_valve_that_works_one_way_keeps_range_and_estimators():
    valve = written(lambda t: 46 + 45 * np.sin(t) + 0.5 * np.cos(9 * t))
    assert not {"U_range_percent", "estimators"} & valve.model_fields_set
