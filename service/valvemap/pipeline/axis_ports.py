"""The results of axes, and the ports that show and demand them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from valvemap.model.samples import Floats
from valvemap.pipeline.alarm_results import AlarmReport
from valvemap.pipeline.axis_tracking import AxisTracking
from valvemap.pipeline.operator_ports import Command
from valvemap.vocabulary.feed_forward import FeedForwardStatus
from valvemap.vocabulary.findings import Finding
from valvemap.vocabulary.statuses import AxisStatus, InverseStatus


@dataclass(frozen=True)
class RequiredU:
    """The signal for a speed: U and its 95 % interval, %, and the status."""

    U: float = np.nan
    lower: float = np.nan
    upper: float = np.nan
    status: InverseStatus = InverseStatus.UNIDENTIFIED


@dataclass(frozen=True)
class AxisMap:
    """The map of an axis and its parameters.

    Attributes
    ----------
    bulk_modulus, leakage, air
        Value and standard deviation: GPa, l/min/bar, % of free air at atmospheric pressure.
    play_percent, spool_hz
        Width of the loop of U; natural frequency of the spool, inf: it follows at once.
    U
        Positions of the spool (n,), %.
    flow, flow_std
        Each edge's flow at 70 bar over it and its standard deviation, (4, n), l/min.
    known
        Position up to which each edge is identified, (4,), %.
    """

    bulk_modulus: tuple[float, float]
    leakage: tuple[float, float]
    air: tuple[float, float]
    play_percent: float
    spool_hz: float
    U: Floats
    flow: Floats
    flow_std: Floats
    known: Floats


@dataclass(frozen=True)
class AxisResults:
    """The state of one axis; ``t`` is the time of its newest sample, UTC ns; 0: there is none.

    ``left_out`` has the number of intervals by reason; ``used_s`` is the movement learnt from, s.
    ``findings`` are the changes since the reference, None: there is no reference yet. ``is_stale``:
    no sample has come for long. ``alarms`` are all alarms of the axis. ``tracking`` is renewed once
    a second; None: there is no set position. ``counters`` are those of the arrival of samples, by
    name; ``waiting`` says why no samples come, a sentence for each signal at fault.
    """

    status: AxisStatus
    sentence: str
    t: int
    used_s: float
    left_out: Mapping[str, int]
    map: AxisMap | None
    required: RequiredU
    findings: tuple[Finding, ...] | None = None
    is_armed: bool = False
    feed_forward: FeedForwardStatus = FeedForwardStatus.NOT_CONFIGURED
    is_stale: bool = False
    alarms: tuple[AlarmReport, ...] = ()
    tracking: AxisTracking | None = None
    counters: Mapping[str, int] = field(default_factory=dict)
    waiting: tuple[str, ...] = ()

    @property
    def numbers(self) -> dict[str, float]:
        """The values of `AXIS_QUANTITIES`; without a map, of Used alone."""
        numbers = {"Used": self.used_s}
        if self.map is None:
            return numbers
        pairs = {
            "BulkModulus": self.map.bulk_modulus,
            "Leakage": self.map.leakage,
            "Air": self.map.air,
        }
        for name, (value, std) in pairs.items():
            numbers |= {name: value, f"{name}Std": std}
        return numbers | {"Play": self.map.play_percent, "SpoolFrequency": self.map.spool_hz}


class AxisOperator(Protocol):
    """Answers for axes; all speeds in mm/s, > 0 extends."""

    def set_reference(self, axis: str) -> None:
        """Relearn the axis: findings are then relative to its condition from now on."""

    def arm_axis(self, axis: str, *, armed: bool) -> None:
        """Let the answer to the demand be written to the valve, or no longer."""

    def demand_speed(self, axis: str, v: float) -> None:
        """Demand a speed; NaN withdraws the demand."""

    def invert_speed(
        self, axis: str, v: float, pA: float, pB: float, pS: float, pT: float, T: float
    ) -> RequiredU:
        """Return the signal for a speed at these pressures (bar) and T (°C).

        NaN takes that of the newest sample.
        """

    def alarms_of(self, axis: str) -> tuple[AlarmReport, ...]:
        """Return the state of all alarms of an axis."""

    def act_on_alarm(self, command: Command) -> None:
        """Acknowledge, confirm or comment an alarm of the axis that the command names as valve.

        Raises
        ------
        CommandRejected
            if there is nothing to acknowledge or confirm.
        """


class AxisSink(Protocol):
    """Shows the results of axes."""

    def show_axis(self, axis: str, results: AxisResults) -> None:
        """Show the newest results of one axis."""
