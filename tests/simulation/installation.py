"""How the simulated plant is configured, and the edits of a configuration between two lives."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from simulation.meeting import METER
from simulation.ports import NAMES, PARTS
from valvemap.model.leakage import Leakage
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.sensor_accuracy import SensorAccuracy
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.edges import LEAK, Part
from valvemap.pipeline.feedforward import FeedForward
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.meaning import Meaning, SignalMeaning
from valvemap.pipeline.quality_gate import QualityGate
from valvemap.pipeline.valve_state import ValvePlan
from valvemap.vocabulary.signals import MEASURED, PER_VALVE

RLS: Final = "RLS"
OWN: Final = "Own"  # the same estimator under another name
ALSO: Final = "Also"  # another one beside it
MOST_PENDING: Final = 256

_GPM: Final = 0.264172052358  # l/min in gpm: exact for RLS, up to rounding
_HALF: Final = 0.5  # of pressures or U: there is no exact conversion


@dataclass(frozen=True)
class Installed:
    """The configuration of one valve. Gains are those of Q, of both pressures and of U."""

    valve: int
    name: str
    estimator: str = RLS
    also: bool = False
    node: int = 0
    flow: float = 1.0
    pressure: float = 1.0
    command: float = 1.0
    accuracy: float = 0.0
    part: Part | None = None
    meter: str = ""
    led: FeedForward | None = None

    @property
    def gains(self):
        """Factors (PER_VALVE,) of the node's numbers."""
        return np.array([self.command, self.pressure, self.pressure, self.flow, 1.0, 1.0])

    @property
    def meaning(self):
        """What is stored with its states."""
        accuracies = {"Q": self.accuracy}
        signals = {
            name: SignalMeaning(
                f"{self.valve}.{name}.{self.node}",
                f"a unit of {gain:g}",
                float(gain),
                0.0,
                accuracies.get(name, 0.0),
            )
            for name, gain in zip(MEASURED, self.gains, strict=False)
        }
        return Meaning("opc.tcp://plant", signals, {self.estimator: 1.0})

    def keeps_map_of(self, before):
        """Whether a map learnt under a former configuration is valid in this one, or converted."""
        return (self.node, self.pressure, self.command) == (
            before.node,
            before.pressure,
            before.command,
        )


def installed(case):
    """The first configuration of all valves."""
    if case.ports:
        return [
            Installed(k, name, RLS if part.edge else LEAK, part=part)
            for k, (name, part) in enumerate(zip(NAMES, PARTS, strict=True))
        ]
    of_all = Installed(0, "", meter=METER if case.meter else "", led=case.led)
    return [replace(of_all, valve=valve, name=f"V{valve}") for valve in range(case.valves)]


def edited(plant, kind, valve):
    """The configuration after an edit; each undoes the one before it of its kind, but for nodes."""
    one, after = plant[valve], list(plant)
    match kind:
        case "flow":
            after[valve] = replace(one, flow=_GPM if one.flow == 1.0 else 1.0)
        case "pressure":
            after[valve] = replace(one, pressure=_HALF if one.pressure == 1.0 else 1.0)
        case "command":
            after[valve] = replace(one, command=_HALF if one.command == 1.0 else 1.0)
        case "node":
            after[valve] = replace(one, node=one.node + 1)
        case "name":
            after[valve] = replace(one, name=f"{one.name}x")
        case "swap":
            other = (valve + 1) % len(plant)
            after[valve] = replace(one, name=plant[other].name)
            after[other] = replace(plant[other], name=one.name)
        case "estimator":
            after[valve] = replace(one, estimator=OWN if one.estimator == RLS else RLS)
        case "also":
            after[valve] = replace(one, also=not one.also)
        case "accuracy":
            after[valve] = replace(one, accuracy=2.0 - one.accuracy)
        case _:
            raise ValueError(kind)
    return after


def fresh(case, plant):
    """An identification of the configured valves that has learnt nothing."""
    numbered = {valve: part.numbered for part in case.sources for valve in part.valves}
    settings = AlignmentSettings(
        max_wait_ns=round(2e9 * reorder(case)),
        reorder_ns=round(1e9 * reorder(case)),
        max_pending=MOST_PENDING,
    )
    flags = tuple(numbered[valve] for valve in range(case.valves))
    plans = [_plan(one) for one in plant]
    return Identification(plans, Alignment(settings, (("T",),) * case.valves, flags))


def _plan(one):
    also = {ALSO: RecursiveLeastSquares(p0=1e6)} if one.also else {}
    own = Leakage() if one.estimator == LEAK else RecursiveLeastSquares()
    return ValvePlan(
        one.name,
        QualityGate(),
        {one.estimator: own, **also},
        one.estimator,
        map_Q=(50.0, 100.0),
        map_dp=(50.0, 100.0),
        accuracy=SensorAccuracy(Q=one.accuracy),
        meaning=one.meaning,
        part=one.part,
        insist=one.estimator == LEAK or bool(one.meter),
        meter=one.meter,
        feed_forward=one.led,
    )


def reorder(case):
    """How long samples wait for earlier ones, s: longer than any of a connected source is late."""
    return 4.0 * max(part.publishing_s + part.period_s for part in case.sources)


assert len(Installed(0, "V").gains) == PER_VALVE
