"""Feed-forward control in simulation: the demo's own code against the rig's own physics."""

import numpy as np
import pytest

from valvemap.app.build import build_identification
from valvemap.cli import feedforward
from valvemap.cli.feedforward import FIXED, FROZEN, LIVING, PHASES, Course, commission, demand
from valvemap.config.models import Config
from valvemap.model.samples import Samples
from valvemap_rig.scenario import BUILTIN
from valvemap_rig.simulation import Commands, advance, initial

STEP = 15
SCENARIO = BUILTIN["feedforward"]


@pytest.fixture(scope="module")
def course():
    """All of the scenario, in steps of 0.15 s."""
    identification = build_identification(Config(valves=feedforward.valves()))
    commission(identification, SCENARIO)
    names = [plan.name for plan in identification.plans]
    start_ns = 10**18
    course = Course(identification, start_ns, lead_s=0.08)
    state, U = initial(SCENARIO, start_ns), {}
    for _ in range(round(feedforward.END_S * SCENARIO.sample_rate_hz / STEP) + 1):
        state, block = advance(SCENARIO, state, STEP, Commands(U=U))
        for number, name in enumerate(names):
            v = block.valves[name]
            samples = Samples.of(v.t, v.U, v.p1, v.p2, v.Q, v.T)
            identification.take_samples(number, samples)
            course.take(name, samples)
        U = feedforward.commands(identification)
    return course


@pytest.mark.parametrize(
    "phase", [pytest.param(PHASES[1], id="damaged"), pytest.param(PHASES[2], id="hot")]
)
def test_the_identified_map_misses_the_flow_at_least_five_times_less_than_the_fixed_one(
    course, phase
):
    errors = course.errors(phase)
    assert errors[FIXED] > 5.0 * errors[LIVING]
    assert errors[FROZEN] > 3.0 * errors[LIVING]
    assert course.gain(phase) == pytest.approx(errors[FIXED] / errors[LIVING])


def test_on_the_new_valve_the_fixed_map_is_as_good_as_hysteresis_lets_it_be(course):
    errors = course.errors(PHASES[0])
    assert errors[LIVING] < 0.5
    assert errors[FIXED] < 1.0
    assert errors[FROZEN] > errors[FIXED]


def test_the_comparison_is_told_in_a_table_and_in_a_line(course):
    assert course.table().row_count == len(PHASES)
    assert "30 s after damage: Valvistor" in course.lines()[0]


def test_the_demand_is_within_what_a_damaged_valve_can_pass():
    flows = [demand(t) for t in np.arange(0.0, feedforward.END_S, 0.1)]
    assert min(flows) > 5.0
    assert max(flows) < 75.0


def test_before_the_first_sample_nothing_is_counted():
    identification = build_identification(Config(valves=feedforward.valves()))
    fresh = Course(identification, 0)
    assert np.isnan(fresh.gain(PHASES[0]))
    assert fresh.lines()[0].endswith("not yet counted")
    assert feedforward.commands(identification) == {}
