"""Tracking in simulation: the demo's own code against the rig's own physics."""

from functools import partial

import numpy as np
import pytest

from valvemap.app.axes import plan_of
from valvemap.cli import tracking
from valvemap.cli.tracking import FIXED, LIVING, PHASES, PI, TABLE, Course
from valvemap.config.models import Config
from valvemap.model.axis import AxisSamples
from valvemap.pipeline.axes import Axis
from valvemap_rig.scenario import BUILTIN
from valvemap_rig.simulation import Commands, advance, initial

pytestmark = pytest.mark.timeout(900)

SCENARIO = BUILTIN["tracking"]
START_NS, STEP = 10**18, 5
COMMISSIONING_S, END_S = 120.0, 140.0  # less than the demo takes
UNCOUNTED = PHASES[0].end_s, PHASES[1].start_s - 10.0  # s; answers may come late
SIGNALS = ("U", "x", "pA", "pB", "pS", "pT", "T")


class AtOnce:
    """The operator and the clock of a course whose service answers at once."""

    def __init__(self):
        self.axes, self.armed, self.t = {}, set(), START_NS

    def now(self):
        return self.t

    def arm_axis(self, axis, *, armed):
        assert armed
        self.armed.add(axis)

    def demand_speed(self, axis, v):
        self.axes[axis].demand(v)


def played(names, n, U, end_s=END_S):
    """Samples of some machines of the scenario, n at once, under the commands in ``U``.

    Where nothing is counted, they come four times as many at once.
    """
    machines = tuple(one for one in SCENARIO.machines if one.name in names)
    scenario = SCENARIO.model_copy(update={"machines": machines})
    state = initial(scenario, START_NS)
    done, rate = 0, SCENARIO.sample_rate_hz
    while done <= end_s * rate:
        many = 4 * n if UNCOUNTED[0] <= done / rate < UNCOUNTED[1] else n
        state, block = advance(scenario, state, many, Commands(U=U))
        done += many
        found = block.machines.items()
        yield {
            name: AxisSamples.of(rows.t, **{signal: rows.shown[signal] for signal in SIGNALS})
            for name, rows in found
        }


@pytest.fixture(scope="module")
def course():
    """The scenario; answers act 50 ms after their sample."""
    config = Config(axes=tuple(tracking.axes(SCENARIO)))
    led = [axis for axis in config.axes if axis.name in (FIXED, LIVING)]
    plans = [plan_of(config, axis) for axis in led]
    first = tracking.commissioned(SCENARIO, Axis(plans[-1]), COMMISSIONING_S)
    service = AtOnce()
    found = Course(SCENARIO, service)
    for plan in plans:
        one = Axis(plan, partial(found.take, service, plan.name))
        service.axes[plan.name] = one
        one.learner.continue_from(first.learner.learnt)
    found.begin(START_NS)
    led, U = (FIXED, LIVING), {}
    for samples in played((PI, TABLE), 100, U, PHASES[0].end_s):  # nothing is written to them
        for name, taken in samples.items():
            found.take(service, name, taken)
    for samples in played(led, STEP, U):
        for name, taken in samples.items():
            one, service.t = service.axes[name], int(taken.t[-1])
            one.take(taken)
            while (job := one.learner.job()) is not None:
                one.learner.accept(job())
        answers = {name: service.axes[name].required().U for name in service.armed}
        U |= {name: float(np.clip(u, -100, 100)) for name, u in answers.items() if np.isfinite(u)}
    assert service.armed == {FIXED, LIVING}
    return found


def test_new_the_maps_track_better_than_a_table_and_a_table_better_than_none(course):
    errors = course.errors(PHASES[0])
    assert errors[LIVING] <= 1.1 * errors[FIXED]
    assert errors[LIVING] <= 0.6 * errors[TABLE]
    assert errors[TABLE] <= 0.6 * errors[PI]


def test_a_minute_after_the_damage_the_living_map_tracks_as_before(course):
    errors = course.errors(PHASES[1])
    assert errors[LIVING] <= 0.7 * errors[FIXED]
    assert errors[LIVING] <= 1.5 * course.errors(PHASES[0])[LIVING]
    assert "living map" in course.lines()[0]
    assert course.table().row_count == len(PHASES)


def test_the_four_axes_differ_in_name_writing_and_freezing_alone():
    axes = {axis.name: axis for axis in tracking.axes(SCENARIO)}
    assert list(axes) == [PI, TABLE, FIXED, LIVING]
    assert [axis.frozen for axis in axes.values()] == [False, False, True, False]
    assert [axis.nodes.required_U is None for axis in axes.values()] == [True, True, False, False]
