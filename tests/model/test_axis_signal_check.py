"""A signal that does not fit the others is named, and its answer is not used."""

import re
from dataclasses import replace

import numpy as np
import pytest

from benchmarks import axis
from support.soaked import soaked
from valvemap.model.axis import AxisGeometry, AxisRegression, AxisSamples
from valvemap.model.axis_search import fitted, identify
from valvemap.model.axis_signal_check import inconsistency
from valvemap.vocabulary.statuses import AxisStatus
from valvemap_rig.directional import DirectionalValve
from valvemap_rig.machine import Controller, Machine
from valvemap_rig.scenario import Scenario
from valvemap_rig.simulation import Commands, advance, initial

GEOMETRY = AxisGeometry(63, 45, 800, 1.2, 1.2)
KNOWN = AxisRegression(GEOMETRY, play_percent=2.0, spool_hz=40.0)


def played(k_p=0.9, seconds=70, **spool):  # an identification needs 60
    valve = DirectionalValve(leakage_l_min_bar=0.0, **{"play_percent": 2.0, **spool})
    controller = Controller(k_p_percent_mm=k_p)
    axis = Machine(name="Axis", measures="position", valve=valve, controller=controller)
    scenario = Scenario(valves=(), machines=(axis,), sample_rate_hz=100.0)
    _, block = advance(scenario, initial(scenario, 0), 100 * seconds, Commands())
    return AxisSamples.of(block.machines["Axis"].t, **block.machines["Axis"].shown)


@pytest.fixture(scope="module")
def samples():
    return played(seconds=40)


def inconsistent(known, samples, together):
    """Return the inconsistency beside the delays that a fit of the samples learns."""
    return inconsistency(known, samples, together, fitted(known, samples)[1].theta)


def late(samples, name, n):
    return replace(samples, **{name: np.roll(getattr(samples, name), n)})


def noisy(samples, name, bar):
    noise = bar * np.random.default_rng(3).standard_normal(len(samples))
    return replace(samples, **{name: getattr(samples, name) + noise})


def test_of_signals_that_fit_none_is_inconsistent(samples):
    assert inconsistent(KNOWN, samples, 4.0) is None


def test_noise_of_the_position_is_no_zero_of_a_pressure_where_low_ones_are_left_out():
    """Another zero leaves out other intervals, whose noise has another mean square by chance."""
    noisy = axis.machine(1130, noise_mm=0.5)
    samples = axis.samples(axis.played(noisy, 1130, seconds=200.0))
    spool = {"play_percent": noisy.valve.play_percent, "spool_hz": 24.5}
    known = AxisRegression(GEOMETRY, **spool)
    left_out = known.update(known.initial_state(), samples)[0].reasons()
    assert left_out["low pressure"] > 500
    assert inconsistent(known, samples, 1.0) is None
    wrong = inconsistent(known, replace(samples, pA=samples.pA + 6.0), 1.0)
    assert wrong.words == "pA 6 bar too high"
    assert wrong.is_large


def test_a_late_position_is_named_with_its_delay(samples):
    found = inconsistent(KNOWN, late(samples, "x", 6), 10.0)
    assert found.words == "position or speed 60 ms too late"
    assert found.is_large


@pytest.fixture(scope="module")
def coarse():
    """An axis whose position has 0.5 mm of noise, and its samples."""
    of = axis.machine(1406, noise_mm=0.5)
    return of, axis.samples(axis.played(of, 1406, seconds=120.0))


def test_a_late_position_is_no_slow_spool(coarse):
    """With so much noise, a search takes it for a spool of 5 Hz."""
    _, samples = coarse
    slow = AxisRegression(GEOMETRY, play_percent=3.6, spool_hz=5.0)
    found = inconsistent(slow, late(samples, "x", 6), 2.0)
    assert found.words == "position or speed 60 ms too late"
    assert found.is_large


def test_a_slow_spool_is_no_late_position(coarse):
    of, _ = coarse
    valve = of.valve.model_copy(update={"natural_frequency_hz": 8.0, "damping": 0.8})
    slow = of.model_copy(update={"valve": valve})
    samples = axis.samples(axis.played(slow, 1406, seconds=120.0))
    known = AxisRegression(GEOMETRY, play_percent=valve.play_percent, spool_hz=8.0)
    assert inconsistent(known, samples, 2.0) is None


def test_a_late_command_is_named(samples):
    found = inconsistent(replace(KNOWN, spool_hz=np.inf), late(samples, "U", 6), 10.0)
    assert re.fullmatch("U [67]0 ms too late", found.words)  # 10 ms are as well the spool's
    assert found.is_large


def test_a_wrong_zero_is_named(samples):
    found = inconsistent(KNOWN, replace(samples, pA=samples.pA + 6.0), 10.0)
    assert found.words == "pA 6 bar too high"


@pytest.mark.parametrize("name", ["pA", *soaked("pB")])
def test_a_noisy_pressure_is_named_and_a_quiet_one_is_not(samples, name):
    assert inconsistent(KNOWN, noisy(samples, name, 4.0), 4.0).words == f"{name} noisy"
    assert inconsistent(KNOWN, noisy(samples, name, 0.1), 4.0) is None


def test_two_wrong_signals_are_both_named(samples):
    both = late(replace(samples, pA=samples.pA + 6.0), "x", 6)
    found = inconsistent(KNOWN, both, 10.0)
    assert found.words == "position or speed 60 ms too late, pA 6 bar too high"


@pytest.mark.parametrize("slew", [110.0, *soaked(150.0)])
def test_a_spool_that_cannot_follow_is_named_with_its_speed(slew):
    result = identify(played(k_p=3.0, slew_percent_s=slew), GEOMETRY)
    assert result.status in {AxisStatus.SIGNAL_INCONSISTENT, AxisStatus.BULK_MODULUS}
    told = float(re.search(r"moves by (\d+) %/s", result.sentence).group(1))
    assert abs(told / slew - 1.0) < 0.25


def test_wide_play_is_found():
    result = identify(played(play_percent=14.0), GEOMETRY)
    assert result.status is AxisStatus.OK
    assert result.fit.regression.play_percent == pytest.approx(14.0, abs=0.2)


def test_a_pressure_that_never_changes_is_no_pressure():
    samples = played()
    result = identify(replace(samples, pT=np.zeros(len(samples))), GEOMETRY)
    assert result.status is AxisStatus.MISSING_PRESSURE
    assert "pT never changes" in result.sentence
