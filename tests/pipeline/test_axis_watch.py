"""The reference follows slow drift and no change; closed windows are bounded."""

import dataclasses

import numpy as np
import pytest

from valvemap.model.axis import AxisGeometry, AxisRegression, AxisSamples
from valvemap.model.axis_basis import SIZE
from valvemap.model.axis_search import fitted
from valvemap.pipeline import axis_watch
from valvemap.pipeline.axis_watch import AxisWatch, balance
from valvemap.vocabulary.findings import FindingCode
from valvemap_rig.directional import DirectionalValve
from valvemap_rig.faults import Fault
from valvemap_rig.machine import Machine
from valvemap_rig.scenario import Scenario
from valvemap_rig.simulation import Commands, advance, initial

KNOWN = AxisRegression(AxisGeometry(63, 45, 800, 1.2, 1.2), play_percent=2.0, spool_hz=40.0)
MEMORY_S = 120.0


@pytest.fixture(scope="module")
def rig():
    valve = DirectionalValve(leakage_l_min_bar=0.0, play_percent=2.0)
    return Scenario(valves=(), machines=(Machine(name="Axis", measures="position", valve=valve),))


@pytest.fixture(scope="module")
def begun(rig):
    state, block = advance(rig, initial(rig, 0), 12_000, Commands())
    samples = AxisSamples.of(block.t, **block.machines["Axis"].shown)
    sums, found = fitted(KNOWN, samples)
    forces = balance(found, samples)
    return state, AxisWatch.begin(sums, found, MEMORY_S, np.zeros((SIZE, SIZE)), forces)


def watched(rig, state, watch, seconds, *faults):
    given = Commands(faults=tuple(("Axis", fault) for fault in faults))
    state, block = advance(rig, state, round(100 * seconds), given)
    samples = AxisSamples.of(block.t, **block.machines["Axis"].shown)
    codes = []
    for start in range(0, len(samples), 100):
        watch = watch.after(samples[start : start + 100]).weighed()
        codes += [one.code for one in watch.condition.findings()]
    return state, watch, codes


def test_slow_drift_is_followed_and_nothing_is_found(rig, begun):
    state, watch = begun
    wear = Fault(kind="wear", edge="PA", size=-1, duration_s=600)
    _, after, codes = watched(rig, state, watch, 800, wear)
    assert codes == []
    own = slice(10, 25)
    ratio = np.sum(after.reference.theta[own]) / np.sum(watch.reference.theta[own])
    assert ratio == pytest.approx(0.99, abs=0.004)


def test_a_change_is_found_and_not_followed(rig, begun):
    state, watch = begun
    damage = Fault(kind="damage", edge="PB", size=-10)
    state, after, codes = watched(rig, state, watch, 300, damage)
    assert set(codes) == {FindingCode.PB_CHANGE}
    assert np.array_equal(after.reference.theta, watch.reference.theta)
    assert after.waiting == ()


def test_more_friction_is_found_and_no_heavier_load(rig, begun):
    state, watch = begun
    _, after, codes = watched(rig, state, watch, 60, Fault(kind="friction", size=100))
    assert set(codes) == {FindingCode.FRICTION}
    (finding,) = after.condition.findings()
    assert finding.probability > 0.9
    assert "more dry friction than before" in finding.sentence
    _, _, codes = watched(rig, state, watch, 60, Fault(kind="load", size=100))
    assert codes == []


def test_windows_that_nobody_weighs_are_bounded(begun, monkeypatch):
    monkeypatch.setattr(axis_watch, "WINDOW_S", 0.0)
    _, watch = begun
    nothing = AxisSamples.of(np.arange(1, 3) * 10_000_000)
    for _ in range(100):
        watch = watch.after(nothing)
    assert len(watch.closed) == axis_watch.MOST_WINDOWS
    assert dataclasses.replace(watch).weighed().closed == ()
