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


def one_way(t):
    return 46 + 45 * np.sin(t) + 0.5 * np.cos(9 * t)


def written(U, supply=190.0, load=40.0):
    t = 0.05 * np.arange(400)
    p2 = 60 + load * np.sin(0.37 * t)
    noise = np.random.default_rng(1).normal(0, 0.1, len(t))
    values = {"U": U(t), "p1": supply + noise, "p2": p2}
    dp = supply - p2
    values["Q"] = 0.1 * np.abs(values["U"]) * np.sign(dp) * np.sqrt(np.abs(dp)) + noise
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
    valve = written(one_way)
    assert not {"U_range_percent", "estimators", "dp_range_bar"} & valve.model_fields_set


def test_the_map_covers_the_pressure_drops_that_the_supply_can_give():
    assert written(one_way, supply=290.0).dp_range_bar == (0.0, 315.0)
    assert written(one_way, supply=210.0).dp_range_bar == (0.0, 200.0)  # 10 % beyond are learnt


def test_the_map_covers_a_flow_that_reverses():
    assert written(one_way, supply=60.0, load=50.0).dp_range_bar == (-200.0, 200.0)
