"""What active faults do to the valve, the oil, the sensors and the clock at N samples."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from valvemap_rig.faults import SIZES, EdgeName, Fault, FaultKind
from valvemap_rig.randomness import uniform
from valvemap_rig.records import Floats

GOOD = 0x00000000
BAD_SENSOR_FAILURE = 0x808C0000  # OPC UA Part 8, table of status codes
UNCERTAIN_SENSOR_NOT_ACCURATE = 0x40930000

SPIKE_SHARE = 0.02

_LASTING = frozenset({FaultKind.WEAR, FaultKind.TEMPERATURE_RAMP})


class ActiveFault(NamedTuple):
    """A fault, and the number of its first sample."""

    fault: Fault
    start: int


Faults = tuple[ActiveFault, ...]


def still_felt(faults: Faults, index: int, rate: float) -> Faults:
    """Return the faults with an effect at sample ``index`` or later."""
    return tuple(active for active in faults if not _is_over(active, index, rate))


def edge_factor(
    faults: Faults, index: NDArray[np.int64], rate: float, edge: EdgeName | None = None
) -> Floats:
    """Return an edge's flow relative to the new valve, (N,): wear and damage multiply.

    The product is limited, so that a part of the edge and of the poppet always remains.
    """
    factor = np.ones(index.shape)
    for active in faults:
        if active.fault.edge not in (None, edge):
            continue
        if active.fault.kind is FaultKind.WEAR:
            factor = factor * (1 + 0.01 * active.fault.size * _progress(active, index, rate))
        elif active.fault.kind is FaultKind.DAMAGE:
            factor = factor * (1 + 0.01 * active.fault.size * _is_on(active, index, rate))
    return np.clip(factor, 0.01, 10.0)


def total_size(faults: Faults, kind: FaultKind, index: NDArray[np.int64], rate: float) -> Floats:
    """Return the sum of the sizes of all faults of one kind that are on, (N,)."""
    total = np.zeros(index.shape)
    for active in faults:
        if active.fault.kind is kind:
            total = total + active.fault.size * _is_on(active, index, rate)
    return total


def spool_frequency(faults: Faults, hz: float, index: NDArray[np.int64], rate: float) -> Floats:
    """Return the spool's natural frequency, Hz, (N,)."""
    percent = total_size(faults, FaultKind.SLUGGISH, index, rate)
    return np.asarray(hz * np.clip(1.0 + 0.01 * percent, 0.1, 2.0))


def worn_gap(faults: Faults, index: NDArray[np.int64], rate: float) -> Floats:
    """Return the flow coefficient of the worn gap, l/min per √bar, (N,): gaps add up."""
    gap = np.zeros(index.shape)
    for active in faults:
        if active.fault.kind is FaultKind.EDGE:
            gap = gap + active.fault.size * _is_on(active, index, rate)
    return np.clip(gap, 0.0, SIZES[FaultKind.EDGE][1])


def temperature_rise(faults: Faults, index: NDArray[np.int64], rate: float) -> Floats:
    """Return the total of the temperature ramps, K, (N,), limited to ±50 K."""
    rise = np.zeros(index.shape)
    for active in faults:
        if active.fault.kind is FaultKind.TEMPERATURE_RAMP:
            rise = rise + active.fault.size * _progress(active, index, rate)
    return np.clip(rise, -50.0, 50.0)


def clock_error_ns(faults: Faults, index: NDArray[np.int64], rate: float) -> NDArray[np.int64]:
    """Return the clock error, ns in multiples of 100, (N,)."""
    error = np.zeros(index.shape, dtype=np.int64)
    for active in faults:
        if active.fault.kind is FaultKind.CLOCK_STEP:
            error = error + round(active.fault.size * 1e7) * 100 * _is_on(active, index, rate)
    return error


class SensorFaults(NamedTuple):
    """Effects of the faults on one signal at N samples, all arrays of shape (N,)."""

    added: Floats
    lag_s: Floats
    frozen: NDArray[np.bool_]
    status: NDArray[np.uint32]
    present: NDArray[np.bool_]


def sensor_faults(
    faults: Faults, signal: str, index: NDArray[np.int64], rate: float, seed: int, valve: str
) -> SensorFaults:
    """Return the effects of the faults on one signal."""
    added, lag_s = np.zeros((2, *index.shape))
    sums = {FaultKind.OFFSET: added, FaultKind.LAG: lag_s}
    frozen = np.zeros(index.shape, dtype=np.bool_)
    status = np.full(index.shape, GOOD, dtype=np.uint32)
    present = np.ones(index.shape, dtype=np.bool_)
    for active in faults:
        fault = active.fault
        if not fault.affects(signal) or index.size == 0:
            continue
        on = _is_on(active, index, rate)
        if not on.any():
            continue
        # One draw per kind for all signals of a valve: a sample drops out as a whole.
        dice = uniform(seed, f"{valve}.{fault.kind}", int(index[0]), index.size)
        match fault.kind:
            case FaultKind.FROZEN:
                frozen |= on
            case FaultKind.SPIKES:
                sign = np.where(dice < 0.5 * SPIKE_SHARE, 1.0, -1.0)
                added += np.where(on & (dice < SPIKE_SHARE), fault.size * sign, 0.0)
            case FaultKind.OFFSET | FaultKind.LAG:
                sums[fault.kind] += fault.size * on
            case FaultKind.BAD_QUALITY:
                status[on & (dice < fault.size)] = BAD_SENSOR_FAILURE
            case FaultKind.UNCERTAIN_QUALITY:
                worse = on & (dice < fault.size) & (status == GOOD)
                status[worse] = UNCERTAIN_SENSOR_NOT_ACCURATE
            case FaultKind.DROP_OUT:
                present &= ~(on & (dice < fault.size))
            case _:
                pass
    return SensorFaults(added, lag_s, frozen, status, present)


def _length(active: ActiveFault, rate: float) -> int:
    return max(1, round(active.fault.duration_s * rate))


def _is_on(active: ActiveFault, index: NDArray[np.int64], rate: float) -> NDArray[np.bool_]:
    begun = index >= active.start
    if active.fault.duration_s == 0:
        return begun
    return np.asarray(begun & (index < active.start + _length(active, rate)))


def _progress(active: ActiveFault, index: NDArray[np.int64], rate: float) -> Floats:
    """Return the progress: 0 before the start, rising to 1 at the end of the duration, then 1."""
    return np.clip((index - active.start + 1) / _length(active, rate), 0.0, 1.0)


def _is_over(active: ActiveFault, index: int, rate: float) -> bool:
    if active.fault.kind in _LASTING or active.fault.duration_s == 0:
        return False
    return index >= active.start + _length(active, rate)
