"""Faults of the valve, the oil, the sensors and the clock.

==================  ====================================  ========================================
kind                size                                  what happens
==================  ====================================  ========================================
wear                % of the main edge's flow             drifts there over the duration, and stays
damage              % of the main edge's flow             at once; a duration of 0 = for good
edge                l/min per √bar                        a gap worn into the main edge, at once
sluggish            % of the spool's natural frequency    at once; where spool_hz is above 0
lag                 s                                     additional first-order lag of the signal
temperature_ramp    K                                     tank drifts there over the duration, stays
frozen              not used                              the signal keeps its last value
spikes              in the signal's unit                  2 % of the samples are off by ± size
offset              in the signal's unit                  the signal is off by size
bad_quality         share of samples, 0 … 1               status BadSensorFailure
uncertain_quality   share of samples, 0 … 1               status UncertainSensorNotAccurate
drop_out            share of samples, 0 … 1               the sample is not sent
clock_step          s                                     source timestamps are off by size
leakage             times the machine's leakage           at once, as all that follow
air                 % of the volume                       free air at atmospheric pressure
supply              % of the supply pressure              the pump's set pressure
friction            % of the friction                     of the cylinder
load                % of the load                         on the cylinder
==================  ====================================  ========================================

The last five are of machines alone; their ``wear`` and ``damage`` may name an ``edge``. A sensor
fault affects one signal, by default ``Q`` (of a machine: flows or position); bad_quality,
uncertain_quality and drop_out affect all signals by default.
"""

from collections.abc import Mapping, Sequence
from enum import StrEnum
from types import MappingProxyType
from typing import Final, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator

from valvemap_rig.kernels import Floats
from valvemap_rig.parameters import Parameters
from valvemap_rig.randomness import uniform

Signal = Literal["U", "p1", "p2", "Q", "T"]
SIGNALS: tuple[Signal, ...] = ("U", "p1", "p2", "Q", "T")
MachineSignal = Literal["U", "pP", "pS", "pT", "pA", "pB", "QA", "QB", "x", "T"]
EdgeName = Literal["PA", "AT", "PB", "BT"]
EDGES: tuple[EdgeName, ...] = ("PA", "AT", "PB", "BT")

GOOD = 0x00000000
BAD_SENSOR_FAILURE = 0x808C0000  # OPC UA Part 8, table of status codes
UNCERTAIN_SENSOR_NOT_ACCURATE = 0x40930000

SPIKE_SHARE = 0.02


class FaultKind(StrEnum):
    """The kinds of faults."""

    WEAR = "wear"
    DAMAGE = "damage"
    EDGE = "edge"
    SLUGGISH = "sluggish"
    LAG = "lag"
    TEMPERATURE_RAMP = "temperature_ramp"
    FROZEN = "frozen"
    SPIKES = "spikes"
    OFFSET = "offset"
    BAD_QUALITY = "bad_quality"
    UNCERTAIN_QUALITY = "uncertain_quality"
    DROP_OUT = "drop_out"
    CLOCK_STEP = "clock_step"
    LEAKAGE = "leakage"
    AIR = "air"
    SUPPLY = "supply"
    FRICTION = "friction"
    LOAD = "load"


_SHARE = (0.0, 1.0)
_SIZES: dict[FaultKind, tuple[float, float]] = {
    FaultKind.WEAR: (-90.0, 100.0),
    FaultKind.DAMAGE: (-90.0, 100.0),
    FaultKind.EDGE: (0.0, 10.0),
    FaultKind.SLUGGISH: (-90.0, 100.0),
    FaultKind.LAG: (0.0, 60.0),
    FaultKind.TEMPERATURE_RAMP: (-30.0, 50.0),
    FaultKind.FROZEN: (-1e6, 1e6),
    FaultKind.SPIKES: (-1e6, 1e6),
    FaultKind.OFFSET: (-1e6, 1e6),
    FaultKind.BAD_QUALITY: _SHARE,
    FaultKind.UNCERTAIN_QUALITY: _SHARE,
    FaultKind.DROP_OUT: _SHARE,
    FaultKind.CLOCK_STEP: (-86_400.0, 86_400.0),
    FaultKind.LEAKAGE: (-1.0, 50.0),
    FaultKind.AIR: (0.0, 20.0),
    FaultKind.SUPPLY: (-90.0, 50.0),
    FaultKind.FRICTION: (-90.0, 900.0),
    FaultKind.LOAD: (-90.0, 900.0),
}
UNITS: Final[Mapping[FaultKind, str]] = MappingProxyType(
    {
        FaultKind.WEAR: "% of the main edge's flow",
        FaultKind.DAMAGE: "% of the main edge's flow",
        FaultKind.EDGE: "l/min per √bar",
        FaultKind.SLUGGISH: "% of the spool's natural frequency",
        FaultKind.LAG: "s",
        FaultKind.TEMPERATURE_RAMP: "K",
        FaultKind.FROZEN: "",
        FaultKind.SPIKES: "in the signal's unit",
        FaultKind.OFFSET: "in the signal's unit",
        FaultKind.BAD_QUALITY: "as a share of the samples",
        FaultKind.UNCERTAIN_QUALITY: "as a share of the samples",
        FaultKind.DROP_OUT: "as a share of the samples",
        FaultKind.CLOCK_STEP: "s",
        FaultKind.LEAKAGE: "times the leakage, more",
        FaultKind.AIR: "% of free air, more",
        FaultKind.SUPPLY: "% of the supply pressure",
        FaultKind.FRICTION: "% of the friction",
        FaultKind.LOAD: "% of the load",
    }
)
"""Units of the sizes; "" if not used."""

_OF_SENSORS = frozenset(
    {
        FaultKind.LAG,
        FaultKind.FROZEN,
        FaultKind.SPIKES,
        FaultKind.OFFSET,
        FaultKind.BAD_QUALITY,
        FaultKind.UNCERTAIN_QUALITY,
        FaultKind.DROP_OUT,
    }
)
_OF_ALL_SIGNALS = frozenset(
    {FaultKind.BAD_QUALITY, FaultKind.UNCERTAIN_QUALITY, FaultKind.DROP_OUT}
)
_LASTING = frozenset({FaultKind.WEAR, FaultKind.TEMPERATURE_RAMP})
_OF_EDGES = frozenset({FaultKind.WEAR, FaultKind.DAMAGE})
_OF_MACHINES = frozenset(
    {
        FaultKind.LEAKAGE,
        FaultKind.AIR,
        FaultKind.SUPPLY,
        FaultKind.FRICTION,
        FaultKind.LOAD,
    }
)
VALVE_FAULTS: Final = tuple(kind for kind in FaultKind if kind not in _OF_MACHINES)
_OF_VALVES: Final = frozenset({FaultKind.EDGE, FaultKind.SLUGGISH})
MACHINE_FAULTS: Final = tuple(kind for kind in FaultKind if kind not in _OF_VALVES)
_METERS: Final = frozenset({"Q", "QA", "QB", "x"})  # what a sensor fault concerns by default


class Fault(Parameters):
    """One thing that goes wrong; see the module for what ``size`` means."""

    kind: FaultKind
    start_s: float = Field(default=0.0, ge=0, le=1e9, description="simulated time of its start")
    size: float = 1.0
    duration_s: float = Field(default=0.0, ge=0, le=1e9, description="0 = for good")
    signal: Signal | MachineSignal | None = Field(
        default=None, description="of which sensor; see the module"
    )
    edge: EdgeName | None = Field(default=None, description="of which edge; all if not given")
    valve: str | None = Field(default=None, description="of which valve; all if not given")

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        low, high = _SIZES[self.kind]
        unit = UNITS[self.kind]
        if not low <= self.size <= high:
            raise ValueError(
                f"size of {self.kind} must be within {low:g} … {high:g} {unit}".strip()
            )
        if self.size == 0 and unit:
            raise ValueError(f"size of {self.kind} is 0 {unit}: nothing would happen")
        if self.signal is not None and self.kind not in _OF_SENSORS:
            raise ValueError(f"{self.kind} is not of a sensor; leave out signal")
        if self.edge is not None and self.kind not in _OF_EDGES:
            raise ValueError(f"{self.kind} is not of an edge; leave out edge")
        return self

    def affects(self, signal: str) -> bool:
        """Return whether this fault concerns a signal's sensor."""
        if self.signal is not None:
            return signal == self.signal
        return self.kind in _OF_ALL_SIGNALS or (self.kind in _OF_SENSORS and signal in _METERS)

    @property
    def signals(self) -> tuple[Signal | MachineSignal, ...]:
        """The affected signals of a valve with one edge."""
        if self.signal is not None:
            return (self.signal,)
        if self.kind in _OF_ALL_SIGNALS:
            return SIGNALS
        return ("Q",) if self.kind in _OF_SENSORS else ()


def described_sizes(kinds: Sequence[FaultKind] = VALVE_FAULTS) -> str:
    """Return the meaning and limits of the size of each kind, in one text.

    >>> described_sizes()[:46]
    "wear: % of the main edge's flow, -90 … 100; da"
    """
    return "; ".join(
        f"{kind}: {UNITS[kind]}, {low:g} … {high:g}" if UNITS[kind] else f"{kind}: not used"
        for kind, (low, high) in ((kind, _SIZES[kind]) for kind in kinds)
    )


class FaultError(ValueError):
    """A commanded fault is invalid; the message names the allowed values."""


class Faultable(NamedTuple):
    """The faults of a kind of plant: kinds, signals of its sensors, edges."""

    kinds: tuple[FaultKind, ...] = VALVE_FAULTS
    signals: tuple[str, ...] = SIGNALS
    edges: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """The allowed values of a command's ``kind``."""
        dotted = [f".{signal}" for signal in self.signals]
        which = f"{', '.join(dotted[:-1])} or {dotted[-1]}"
        text = f"{', '.join(self.kinds)}, with {which} behind that of a sensor"
        if self.edges:
            text += f", and {', '.join(f'.{edge}' for edge in self.edges)} behind damage or wear"
        return text


OF_A_VALVE: Final = Faultable()
"""The faults of a valve with one edge."""


def commanded_fault(kind: str, size: float, duration_s: float, of: Faultable = OF_A_VALVE) -> Fault:
    """Return the fault of an operator's command.

    ``kind`` may name the signal, ``"offset.p1"``, or the edge, ``"damage.PA"``.

    Raises
    ------
    FaultError
        naming the argument and the allowed values.

    Examples
    --------
    >>> commanded_fault("frozen.p1", 0.0, 5.0).signals
    ('p1',)
    >>> commanded_fault("rust", 1.0, 0.0)
    Traceback (most recent call last):
    valvemap_rig.faults.FaultError: kind 'rust': allowed are wear, damage, edge, \
sluggish, lag, temperature_ramp, frozen, spikes, offset, bad_quality, uncertain_quality, drop_out, \
clock_step, with .U, .p1, .p2, .Q or .T behind that of a sensor
    """
    name, dot, part = kind.partition(".")
    if name not in of.kinds or (dot and part not in {*of.signals, *of.edges}):
        raise FaultError(f"kind {kind!r}: allowed are {of.sentence}")
    values = {"kind": name, "size": size, "duration_s": duration_s}
    if part:
        values["edge" if part in of.edges else "signal"] = part
    try:
        return Fault.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "fault"
        raise FaultError(f"{where}: {first['msg'].removeprefix('Value error, ')}") from error


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
    return np.clip(gap, 0.0, _SIZES[FaultKind.EDGE][1])


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
