import numpy as np
import pytest

from valvemap_rig.fault_effects import ActiveFault, sensor_faults
from valvemap_rig.faults import Fault
from valvemap_rig.sensors import Sensor, SensorMemory, measure


def shown(sensor, truth, faults=(), memory=None, start=0):
    truth = np.asarray(truth, dtype=float)
    index = np.arange(start, start + len(truth))
    effects = sensor_faults(faults, "Q", index, 100.0, 1, "V")
    before = memory or SensorMemory()
    return measure(sensor, truth, effects, before, 0.01, 1, "V.Q", start)


def test_a_perfect_sensor_shows_the_truth():
    truth = np.random.default_rng(0).normal(size=100)
    assert np.array_equal(shown(Sensor(), truth)[1], truth)


def test_noise_has_the_given_spread_no_mean_and_no_memory():
    _, values = shown(Sensor(noise=0.4), np.full(50_000, 100.0))
    noise = values - 100
    assert noise.std() == pytest.approx(0.4, rel=0.02)
    assert noise.mean() == pytest.approx(0, abs=0.01)
    assert np.corrcoef(noise[:-1], noise[1:])[0, 1] == pytest.approx(0, abs=0.02)


def test_quantisation_shows_multiples_of_the_quantum():
    _, values = shown(Sensor(quantum=0.25), [0.1, 0.2, 0.37, -0.4])
    assert values.tolist() == [0.0, 0.25, 0.25, -0.5]


def test_offset_is_added():
    assert shown(Sensor(offset=-2), [10.0])[1].tolist() == [8.0]


def test_lag_shows_63_percent_of_a_step_after_its_time_constant():
    step = np.concatenate([[0.0], np.ones(100)])
    _, values = shown(Sensor(lag_s=0.5), step)
    assert values[50] == pytest.approx(1 - np.exp(-1), rel=1e-9)


def test_a_frozen_sensor_keeps_the_last_value_it_showed_then_goes_on():
    faults = (ActiveFault(Fault(kind="frozen", duration_s=0.03), 2),)
    assert shown(Sensor(), [0, 1, 2, 3, 4, 5], faults)[1].tolist() == [0, 1, 1, 1, 1, 5]


def test_a_freeze_lasts_over_the_cut_between_blocks():
    faults = (ActiveFault(Fault(kind="frozen"), 2),)
    memory, first = shown(Sensor(), [0, 1, 2], faults)
    _, second = shown(Sensor(), [3, 4], faults, memory, start=3)
    assert [*first, *second] == [0, 1, 1, 1, 1]


def test_a_sensor_frozen_from_the_start_keeps_its_first_value():
    faults = (ActiveFault(Fault(kind="frozen"), 0),)
    assert shown(Sensor(), [7, 8, 9], faults)[1].tolist() == [7, 7, 7]


def test_a_frozen_value_is_noisy_no_more():
    faults = (ActiveFault(Fault(kind="frozen"), 10),)
    _, values = shown(Sensor(noise=1.0), np.zeros(50), faults)
    assert np.unique(values[9:]).size == 1
