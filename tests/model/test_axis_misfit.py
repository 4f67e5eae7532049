"""Residuals that the noise of the piston's signal does not explain: the axis is not as assumed."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import axis_unlike
from benchmarks.axis import GEOMETRY, machine, played, samples
from valvemap.model.axis import AxisRegression, AxisSamples
from valvemap.model.axis_misfit import misfit
from valvemap.model.axis_search import fitted, identify
from valvemap.model.axis_signal_check import MOST_FLOW, NAMELESS
from valvemap.vocabulary.statuses import AxisStatus


def misfit_of(regression, of):
    state, found = fitted(regression, of)
    return misfit(regression, state, of), found


def known(valve):
    """Return the regression with the valve's play, and a spool with its delay."""
    hz = valve.natural_frequency_hz * 0.8 / valve.damping
    return AxisRegression(GEOMETRY, play_percent=valve.play_percent, spool_hz=hz)


@pytest.fixture(scope="module")
def healthy():
    axis = machine(1402)
    return axis, samples(played(axis, 1402, seconds=120.0))


@pytest.mark.parametrize("noise_mm", [0.0, 0.1, 0.5])
def test_noise_of_the_position_is_no_misfit(healthy, noise_mm):
    axis, of = healthy
    noise = noise_mm * np.random.default_rng(5).standard_normal(len(of))
    left, found = misfit_of(known(axis.valve), replace(of, x=of.x + noise))
    assert left < 0.004
    if noise_mm == 0.5:
        assert found.residual_std > 0.2  # l/min; more than the misfit that is refused


def test_a_coarse_position_is_no_misfit(healthy):
    axis, of = healthy
    left, _ = misfit_of(known(axis.valve), replace(of, x=np.round(2.0 * of.x) / 2.0))
    assert left < 0.006


def test_noise_of_a_measured_speed_is_no_misfit(healthy):
    axis, of = healthy
    truth = played(axis, 1402, seconds=120.0).truth["v"]
    noise = 5.0 * np.random.default_rng(6).standard_normal(len(of))
    regression = replace(known(axis.valve), has_place=False)
    left, found = misfit_of(regression, replace(of, v=truth + noise))
    assert left < 0.006
    assert found.residual_std > 0.1


def test_another_valve_in_a_line_is_a_misfit_and_has_the_name_of_no_signal(monkeypatch):
    monkeypatch.setattr(axis_unlike, "SECONDS", 85.0)
    plant = axis_unlike.plants(704)["counterbalance valve, pB before it"]
    shown = axis_unlike.played(plant, 704)
    t = np.arange(len(shown["U"])) * 10_000_000
    of = AxisSamples.of(t, **{name: shown[name] for name in axis_unlike.SIGNALS})
    assert misfit_of(known(plant.axis.valve), of)[0] > MOST_FLOW
    result = identify(of, GEOMETRY)
    assert result.status is AxisStatus.SIGNAL_INCONSISTENT
    assert NAMELESS in result.sentence
