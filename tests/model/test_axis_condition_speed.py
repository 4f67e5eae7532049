"""Causes of an axis's changes where the speed is measured, and the place is a range."""

from dataclasses import replace

import numpy as np
import pytest

from valvemap.model.axis import AxisGeometry, AxisRegression, AxisSamples
from valvemap.model.axis_condition import Condition, Reference, WindowSums
from valvemap.model.axis_fit import with_theta
from valvemap.model.axis_search import fitted
from valvemap.model.axis_travel import Travel
from valvemap.vocabulary.findings import FindingCode
from valvemap_rig.directional import DirectionalValve
from valvemap_rig.faults import Fault
from valvemap_rig.machine import Cylinder, Machine
from valvemap_rig.machine_programme import Programme
from valvemap_rig.scenario import Scenario
from valvemap_rig.simulation import Commands, advance, initial

GEOMETRY = AxisGeometry(63, 45, 800, 1.2, 1.2)
KNOWN = AxisRegression(GEOMETRY, play_percent=2.0, spool_hz=40.0, has_place=False)
SUMS = ("M", "b", "squares", "errors", "score", "scores")
LOWEST, HIGHEST = 0.08, 0.64  # share of the stroke, from which a third is used


class Axis:
    """The rig's axis, its speed with 0.5 mm/s of noise, and the places that it can have."""

    def __init__(self):
        self.state, self.travel = None, Travel.initial()
        self.noise = np.random.default_rng(3)

    def worked(self, seconds, low, *faults):
        """Return samples of work in the third of the stroke from ``low`` on."""
        valve = DirectionalValve(leakage_l_min_bar=0.0, play_percent=2.0)
        programme = Programme(low=low, high=low + 0.28)
        axis = {"cylinder": Cylinder(bulk_modulus_GPa=0.6), "programme": programme}
        machine = Machine(name="Axis", measures="position", valve=valve, **axis)
        scenario = Scenario(valves=(), machines=(machine,))
        commands = Commands(faults=tuple(("Axis", fault) for fault in faults))
        before = self.state or initial(scenario, 0)
        self.state, block = advance(scenario, before, round(100 * seconds), commands)
        found = block.machines["Axis"]
        v = found.truth["v"] + 0.5 * self.noise.standard_normal(len(found.t))
        shown = {name: values for name, values in found.shown.items() if name != "x"}
        samples = AxisSamples.of(block.t, v=v, **shown)
        self.travel, placed = self.travel.update(samples, GEOMETRY.stroke_mm)
        return placed


@pytest.fixture
def known():
    """An axis that has used the lowest third of its stroke alone, and its reference."""
    axis = Axis()
    state, found = fitted(KNOWN, axis.worked(150, LOWEST))
    return axis, with_theta(state, found.theta), Reference.of(found)


def condition_after(state, reference, samples):
    condition = Condition.initial()
    for start in range(0, len(samples), 1_000):
        empty = replace(state, **{name: np.zeros_like(getattr(state, name)) for name in SUMS})
        state, _ = KNOWN.update(empty, samples[start : start + 1_000])
        condition = condition.after(reference, WindowSums.of(state), 10.0)
    return condition


def test_air_is_told(known):
    axis, state, reference = known
    work = axis.worked(40, LOWEST, Fault(kind="air", size=10))
    first, *_ = condition_after(state, reference, work).findings()
    assert first.code is FindingCode.AIR
    assert first.probability > 0.9


def test_work_in_another_part_of_the_stroke_is_no_change(known):
    """The middle of the range of places then lies elsewhere."""
    axis, state, reference = known
    for low in np.linspace(LOWEST, HIGHEST, 15)[1:]:
        gone = axis.worked(3, low)
    state, _ = KNOWN.update(state, gone)
    condition = condition_after(state, reference, axis.worked(120, HIGHEST))
    assert condition.findings() == ()
    assert condition.unchanged > 0.99
