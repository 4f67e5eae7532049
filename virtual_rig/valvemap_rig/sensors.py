"""Sensor models: lag, offset, noise, quantisation and faults."""

from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field

from valvemap_rig.dynamics import changing_lag, lag
from valvemap_rig.fault_effects import SensorFaults
from valvemap_rig.parameters import Parameters
from valvemap_rig.randomness import normal
from valvemap_rig.records import Floats


class Sensor(Parameters):
    """One sensor; everything but the lag in the signal's own unit."""

    noise: float = Field(default=0.0, ge=0, le=1e3, description="standard deviation")
    quantum: float = Field(default=0.0, ge=0, le=1e3, description="smallest step; 0 = none")
    lag_s: float = Field(default=0.0, ge=0, le=1e3, description="time constant; 0 = none")
    offset: float = Field(default=0.0, ge=-1e3, le=1e3)


class Sensors(Parameters):
    """The sensors of each valve: 0.2 % of 200 l/min, 250 bar transducers, a Pt100, a DAC."""

    U: Sensor = Sensor(quantum=0.01)
    p1: Sensor = Sensor(noise=0.05, quantum=0.01)
    p2: Sensor = Sensor(noise=0.05, quantum=0.01)
    Q: Sensor = Sensor(noise=0.4, quantum=0.01)
    T: Sensor = Sensor(noise=0.02, quantum=0.01)
    T_at: Literal["inlet", "outlet"] = Field(
        default="inlet", description="where T is measured; ISO 10770-1 asks for the inlet"
    )


class SensorMemory(NamedTuple):
    """State of a sensor: its lagging value and its last output (NaN = none)."""

    lagging: float = float("nan")
    shown: float = float("nan")


def measure(
    sensor: Sensor,
    truth: Floats,
    faults: SensorFaults,
    memory: SensorMemory,
    period_s: float,
    seed: int,
    stream: str,
    start: int,
) -> tuple[SensorMemory, Floats]:
    """Return the sensor's outputs for N true values; the first is sample number ``start``.

    >>> import numpy as np
    >>> from valvemap_rig.fault_effects import sensor_faults
    >>> fine = sensor_faults((), "Q", np.arange(2), 100.0, 1, "V")
    >>> measure(Sensor(quantum=0.5), np.array([0.4, 0.6]), fine, SensorMemory(), 0.01, 1, "V.Q", 0)
    (SensorMemory(lagging=0.6, shown=0.5), array([0.5, 0.5]))
    """
    if truth.size == 0:
        return memory, truth
    if faults.lag_s.any():
        lags_s = sensor.lag_s + faults.lag_s
        lagging = changing_lag(truth, lags_s, period_s, memory.lagging)
    else:
        lagging = lag(truth, sensor.lag_s, period_s, memory.lagging)
    shown = lagging + sensor.offset + faults.added
    if sensor.noise > 0:
        shown = shown + sensor.noise * normal(seed, f"{stream} noise", start, truth.size)
    if sensor.quantum > 0:
        shown = np.rint(shown / sensor.quantum) * sensor.quantum
    if faults.frozen.any():
        shown = _held(shown, faults, memory.shown)
    return SensorMemory(float(lagging[-1]), float(shown[-1])), shown


def _held(shown: Floats, faults: SensorFaults, before: float) -> Floats:
    """Return the outputs with each frozen value replaced by the last one before the freeze."""
    source = np.maximum.accumulate(np.where(faults.frozen, -1, np.arange(shown.size)))
    first = shown[0] if np.isnan(before) else before
    return np.where(source < 0, first, shown[np.maximum(source, 0)])
