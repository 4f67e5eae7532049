"""A signal that does not fit the others is named, and its answer is not used."""

from dataclasses import replace

import numpy as np
import pytest

from valvemap.model.axis import AxisGeometry, AxisRegression, AxisSamples
from valvemap.model.axis_search import identify
from valvemap.model.axis_signal_check import inconsistency
from valvemap.vocabulary.statuses import AxisStatus
from valvemap_rig.directional import DirectionalValve
from valvemap_rig.machine import Machine
from valvemap_rig.scenario import Scenario
from valvemap_rig.simulation import Commands, advance, initial

GEOMETRY = AxisGeometry(63, 45, 800, 1.2, 1.2)
KNOWN = AxisRegression(GEOMETRY, play_percent=2.0, spool_hz=40.0)


@pytest.fixture(scope="module")
def samples():
    valve = DirectionalValve(leakage_l_min_bar=0.0, play_percent=2.0)
    axis = Machine(name="Axis", measures="position", valve=valve)
    scenario = Scenario(valves=(), machines=(axis,), sample_rate_hz=100.0)
    _, block = advance(scenario, initial(scenario, 0), 7000, Commands())
    return AxisSamples.of(block.machines["Axis"].t, **block.machines["Axis"].shown)


def late(samples, name, n):
    return replace(samples, **{name: np.roll(getattr(samples, name), n)})


def noisy(samples, name, bar):
    noise = bar * np.random.default_rng(3).standard_normal(len(samples))
    return replace(samples, **{name: getattr(samples, name) + noise})


def test_of_signals_that_fit_none_is_inconsistent(samples):
    assert inconsistency(KNOWN, samples, 4.0) is None


def test_a_late_position_is_named_with_its_delay(samples):
    found = inconsistency(KNOWN, late(samples, "x", 6), 10.0)
    assert found.words == "position or speed 60 ms too late"
    assert found.is_large


def test_a_wrong_zero_is_named(samples):
    found = inconsistency(KNOWN, replace(samples, pA=samples.pA + 6.0), 10.0)
    assert found.words == "pA 6 bar too high"


@pytest.mark.parametrize("name", ["pA", "pB"])
def test_a_noisy_pressure_is_named_and_a_quiet_one_is_not(samples, name):
    assert inconsistency(KNOWN, noisy(samples, name, 4.0), 4.0).words == f"{name} noisy"
    assert inconsistency(KNOWN, noisy(samples, name, 0.1), 4.0) is None


def test_a_pressure_that_never_changes_is_no_pressure(samples):
    result = identify(replace(samples, pT=np.zeros(len(samples))), GEOMETRY)
    assert result.status is AxisStatus.MISSING_PRESSURE
    assert "pT never changes" in result.sentence
