"""What the service writes to valves that it leads, as feed-forward: judged when it arrives."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from valvemap.pipeline.feedforward import MOST_STEP_S, STALLED_S, Fallback
from valvemap.pipeline.operator_ports import Command
from valvemap.vocabulary.signals import Signal

DEMANDS: Final = (20.0, 45.0, 70.0)  # l/min, at the drop below
_DROP_BAR: Final = 80.0
_CLOSE: Final = 1e-6  # %


@dataclass
class _Led:
    """One valve, as its source sees it."""

    armed: bool = False
    U: float = np.nan  # the command in effect
    beaten: float = -np.inf
    count: int = 0
    heard: float = -np.inf  # when the newest sample was learnt
    known: set = field(default_factory=set)  # its samples so far


class Leading:
    """All valves of a world; a new process leads none."""

    def __init__(self, world):
        self._world, self._settings = world, world.case.led
        self.begin()

    def begin(self):
        """A process starts."""
        self._valves = [_Led() for _ in range(self._world.case.valves)]

    def operate(self, identification, kind, valve):
        """A client arms, disarms, demands a flow, or withdraws its demand."""
        name = self._world.plant[valve].name
        match kind:
            case "arm" | "disarm":
                self._valves[valve].armed = kind == "arm"
                identification.do(Command.of(kind, name))
            case "withdraw":
                identification.do(Command.of("demand", name, np.nan, np.nan))
            case _:
                identification.do(Command.of("demand", name, float(kind), _DROP_BAR))
        self._world.counts["led by a client"] += 1

    def heard(self, valve, rows):
        """The service has learnt these samples."""
        one = self._valves[valve]
        one.heard = self._world.time.elapsed
        one.known.update(rows)

    def lost(self, valves):
        """The connection is lost: the service leads these valves no longer."""
        for valve in valves:
            self._valves[valve].U = np.nan

    def wrote_U(self, valve, U):
        """A command has arrived."""
        one, low_high = self._valves[valve], self._settings.U_range
        if not one.armed:
            self._world.violated(f"V{valve} is commanded {U:g} %, though not armed")
        if not low_high[0] <= U <= low_high[1]:
            self._world.violated(f"V{valve} is commanded {U:g} %, outside {low_high}")
        if not (self._continues(one, U) or self._begins(one, valve, U)):
            age_s = self._world.time.elapsed - one.heard
            self._world.violated(f"V{valve} is moved from {one.U:g} to {U:g} %, {age_s:.2f} s old")
        if not self._is_streak(one):
            one.beaten = -np.inf
        one.U = U
        self._world.counts["commands"] += 1
        self._world.note((valve, U))

    def beat(self, valve, count):
        """A heartbeat has arrived; 0 hands the valve back."""
        one = self._valves[valve]
        if count == 0:
            one.U, one.beaten = np.nan, -np.inf
            return
        if not one.armed:
            self._world.violated(f"V{valve} has a heartbeat, though not armed")
        if self._is_old(one) and self._settings.fallback is Fallback.HAND_BACK:
            self._world.violated(f"V{valve} is not handed back, though its samples are old")
        one.beaten, one.count = self._world.time.elapsed, count

    def _is_streak(self, one):
        stalled = np.isfinite(one.beaten) and self._world.time.elapsed - one.beaten > STALLED_S
        return np.isfinite(one.U) and not stalled

    def _is_old(self, one):
        age_s = self._world.time.elapsed - one.heard
        return age_s > self._settings.max_age_s + self._world.case.sink_s + _CLOSE

    def _continues(self, one, U):
        """Whether a command follows the one before it, at the slew, and no old sample."""
        settings = self._settings
        if not self._is_streak(one) or (
            abs(U - one.U) > settings.slew_percent_per_s * MOST_STEP_S + _CLOSE
        ):
            return False
        if not self._is_old(one):
            return True
        nearer = abs(U - settings.fallback_U) <= abs(one.U - settings.fallback_U)
        return settings.fallback is Fallback.RAMP and nearer

    def _begins(self, one, valve, U):
        """Whether a command is the U measured, of samples that are not old."""
        column = self._world.server_of[valve].values[valve][:, Signal.U]
        measured = np.clip(column[sorted(one.known)], *self._settings.U_range)
        return not self._is_old(one) and bool(np.isclose(measured, U, atol=_CLOSE).any())
