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

from pydantic import Field, ValidationError, model_validator

from valvemap_rig.parameters import Parameters

Signal = Literal["U", "p1", "p2", "Q", "T"]
SIGNALS: tuple[Signal, ...] = ("U", "p1", "p2", "Q", "T")
MachineSignal = Literal["U", "pP", "pS", "pT", "pA", "pB", "QA", "QB", "x", "T"]
EdgeName = Literal["PA", "AT", "PB", "BT"]
EDGES: tuple[EdgeName, ...] = ("PA", "AT", "PB", "BT")


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
SIZES: dict[FaultKind, tuple[float, float]] = {
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
"""Limits of the sizes."""
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
        low, high = SIZES[self.kind]
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
        for kind, (low, high) in ((kind, SIZES[kind]) for kind in kinds)
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
