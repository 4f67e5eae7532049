"""A cylinder follows moves with four feed-forwards, on the rig, with latency.

The rig's position controller (PI) follows a programme; beside it acts nothing, a one-dimensional
table of the new valve, the axis' four-edge map as it was when new, or the living map. The last two
are the service's own `Axis`, whose answer acts ``delay`` samples of 10 ms after the sample it is
made from; the set speed is asked for as much ahead. The clock is the simulation's.
"""

import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np

from valvemap.model.axis import AxisGeometry, AxisSamples
from valvemap.model.samples import Floats
from valvemap.pipeline.axes import Axis
from valvemap.pipeline.axis_plan import AxisPlan
from valvemap_rig.directional import DirectionalValve
from valvemap_rig.faults import Fault, FaultKind
from valvemap_rig.machine import Controller, Cylinder, Lead, Machine
from valvemap_rig.machine_programme import moves
from valvemap_rig.scenario import Scenario
from valvemap_rig.simulation import Commands, RigState, advance, initial

GEOMETRY: Final = AxisGeometry(63, 45, 800, 1.2, 1.2)
RATE_HZ: Final = 100.0
COMMISSIONED_S: Final = 320.0  # about 240 s of movement: play and spool are settled
SETTLED_S: Final = 6.0  # s; two moves: the controller's integral, learnt beside the table, has gone
MEASURED_S: Final = 40.0  # s
EDGES: Final = ("PA", "AT", "PB", "BT")


@dataclass(frozen=True)
class Case:
    """What happens at second 0, and when the error is measured, s."""

    name: str
    faults: tuple[Fault, ...]
    start_s: float
    end_s: float
    bars: tuple[float, float]  # of the living map, over the fixed one and over the table


@dataclass(frozen=True)
class Course:
    """Set position and position while the error is measured, mm, (N,) each."""

    x_set: Floats
    x: Floats

    @property
    def rms(self) -> float:
        """Root mean square of the tracking error, mm."""
        return float(np.sqrt(np.mean((self.x - self.x_set) ** 2)))


def cases(seed: int) -> tuple[Case, ...]:
    """Return the rows of a seed; which two edges are damaged is drawn."""
    one, two = np.random.default_rng(seed).choice(4, 2, replace=False)
    worn = tuple(
        Fault(kind=FaultKind.DAMAGE, start_s=0, size=-30, edge=EDGES[k]) for k in (one, two)
    )
    supply = (Fault(kind=FaultKind.SUPPLY, size=-22),)
    load = (Fault(kind=FaultKind.LOAD, size=100),)

    def case(
        name: str, faults: tuple[Fault, ...], start_s: float, bars: tuple[float, float]
    ) -> Case:
        return Case(name, faults, start_s, start_s + MEASURED_S, bars)

    return (
        case("new", (), SETTLED_S, (1.1, 0.6)),
        case("supply -22 %", supply, SETTLED_S, (1.1, 0.6)),
        case("load x 2", load, SETTLED_S, (np.nan, np.nan)),
        case("two edges -30 %, 60 s later", worn, 60.0, (0.7, np.nan)),
    )


def scenario_of(seed: int, lead: Lead, machine: Machine) -> Scenario:
    """Return the rig of a seed: this valve on the default cylinder."""
    axis = machine.model_copy(update={"cylinder": Cylinder(), "controller": Controller(lead=lead)})
    return Scenario(seed=seed, valves=(), machines=(axis,), sample_rate_hz=RATE_HZ)


def commissioned(seed: int, machine: Machine) -> tuple[Axis, RigState]:
    """Return the axis after work with the table, and the rig then."""
    scenario = scenario_of(seed, "table", machine)
    axis, state = Axis(AxisPlan("Axis", GEOMETRY)), initial(scenario, 0)
    for _ in range(round(COMMISSIONED_S * 10)):
        state, block = advance(scenario, state, round(RATE_HZ / 10))
        axis.take(AxisSamples.of(block.machines["Axis"].t, **block.machines["Axis"].shown))
        work(axis)
    return axis, state


def work(axis: Axis) -> None:
    """Do what is due."""
    while (job := axis.learner.job()) is not None:
        axis.learner.accept(job())


def tracked(
    seed: int,
    machine: Machine,
    case: Case,
    state: RigState,
    lead: Lead,
    axis: Axis | None,
    delay: int,
) -> Course:
    """Return the course of a case; ``axis`` answers, if there is one, ``delay`` samples later."""
    scenario = scenario_of(seed, lead, machine)
    stroke_mm = scenario.machines[0].cylinder.stroke_mm
    n, begin = round(case.end_s * RATE_HZ), state.index
    ahead = np.arange(begin, begin + n) + delay
    _, v_set = moves(machine.programme, stroke_mm, ahead, RATE_HZ, seed, "Axis")
    commands = Commands(faults=tuple(("Axis", fault) for fault in case.faults))
    waiting, truths = [0.0] * delay, []
    step = 10 if axis is None else 1
    for k in range(0, n, step):
        if axis is not None:
            commands = replace(commands, U={"Axis": waiting.pop(0)})
        state, block = advance(scenario, state, step, commands)
        commands, found = Commands(), block.machines["Axis"]
        if k >= case.start_s * RATE_HZ:
            truths.append(found.truth)
        if axis is not None:
            axis.demand(float(v_set[k]))
            axis.take(AxisSamples.of(found.t, **found.shown))
            work(axis)
            U = axis.required().U
            waiting.append(float(np.clip(0.0 if np.isnan(U) else U, -100.0, 100.0)))
    x_set, x = (np.concatenate([truth[name] for truth in truths]) for name in ("xSet", "x"))
    return Course(x_set, x)


def side_by_side(
    seed: int, machine: Machine, case: Case, axis: Axis, state: RigState, delay: int
) -> dict[str, Course]:
    """Return the course with each of the four feed-forwards."""
    fixed, living = copy.deepcopy(axis), copy.deepcopy(axis)
    fixed.plan = replace(fixed.plan, is_frozen=True)
    return {
        "PI alone": tracked(seed, machine, case, state, "none", None, delay),
        "table": tracked(seed, machine, case, state, "table", None, delay),
        "fixed map": tracked(seed, machine, case, state, "external", fixed, delay),
        "living map": tracked(seed, machine, case, state, "external", living, delay),
    }


@dataclass(frozen=True)
class Motion:
    """Root mean square tracking errors, mm, by case and feed-forward."""

    errors: Mapping[str, Mapping[str, float]]

    @classmethod
    def measured(cls, seed: int, delay: int = 1) -> Self:
        """Follow the moves of a seed with the default valve of the rig."""
        valve = DirectionalValve(leakage_l_min_bar=0.0, play_percent=2.0)
        machine = Machine(name="Axis", measures="position", valve=valve)
        axis, state = commissioned(seed, machine)
        return cls(
            {
                case.name: {
                    name: course.rms
                    for name, course in side_by_side(
                        seed, machine, case, axis, state, delay
                    ).items()
                }
                for case in cases(seed)
            }
        )
