"""Tracking error of a cylinder with four feed-forwards, on the rig, with latency.

``python -m benchmarks.axis_tracking [--seeds 2] [--first 50] [--picture FILE]``: one table. The
rig's position controller (PI) follows a programme of moves; beside it acts nothing, a
one-dimensional table of the new valve, the axis' map as it was when new, or the living map. The
last two are the service's own `Axis`, whose answer acts ``delay`` samples of 10 ms after the sample
it is made from; the set speed is asked for as much ahead. The clock is the simulation's. Each seed
is another valve, load and programme. ``--picture`` draws the four after the damage, at the first
seed, with the longest delay.
"""

import argparse
import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import matplotlib.pyplot as plt
import numpy as np

from benchmarks.axis import GEOMETRY, machine, samples
from valvemap.model.samples import Floats
from valvemap.pipeline.axes import Axis, AxisPlan
from valvemap_rig.faults import Fault, FaultKind
from valvemap_rig.machine import Controller, Cylinder, Lead, Machine
from valvemap_rig.machine_programme import moves
from valvemap_rig.scenario import Scenario
from valvemap_rig.simulation import Commands, RigState, advance, initial

RATE_HZ: Final = 100.0
COMMISSIONED_S: Final = 320.0  # about 240 s of movement: play and spool are settled
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
    return (
        Case("new", (), 0.0, 40.0, (1.1, 0.6)),
        Case("supply -22 %", supply, 5.0, 45.0, (1.1, 0.6)),
        Case("load x 2", load, 5.0, 45.0, (np.nan, np.nan)),
        Case("two edges -30 %, 60 s later", worn, 60.0, 100.0, (0.7, np.nan)),
    )


def scenario_of(seed: int, lead: Lead) -> Scenario:
    """Return the rig of a seed."""
    drawn: Machine = machine(seed)
    axis = drawn.model_copy(update={"cylinder": Cylinder(), "controller": Controller(lead=lead)})
    return Scenario(seed=seed, valves=(), machines=(axis,), sample_rate_hz=RATE_HZ)


def commissioned(seed: int) -> tuple[Axis, RigState]:
    """Return the axis after work with the table, and the rig then."""
    scenario = scenario_of(seed, "table")
    axis, state = Axis(AxisPlan("Axis", GEOMETRY)), initial(scenario, 0)
    for _ in range(round(COMMISSIONED_S * 10)):
        state, block = advance(scenario, state, round(RATE_HZ / 10))
        axis.take(samples(block.machines["Axis"]))
        work(axis)
    return axis, state


def work(axis: Axis) -> None:
    """Do what is due."""
    while (job := axis.job()) is not None:
        axis.accept(job())


def tracked(
    seed: int, case: Case, state: RigState, lead: Lead, axis: Axis | None, delay: int
) -> Course:
    """Return the course of a case; ``axis`` answers, if there is one, ``delay`` samples later."""
    scenario = scenario_of(seed, lead)
    machine = scenario.machines[0]
    n, begin = round(case.end_s * RATE_HZ), state.index
    ahead = np.arange(begin, begin + n) + delay
    _, v_set = moves(machine.programme, machine.cylinder.stroke_mm, ahead, RATE_HZ, seed, "Axis")
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
            axis.take(samples(found))
            work(axis)
            U = axis.required().U
            waiting.append(float(np.clip(0.0 if np.isnan(U) else U, -100.0, 100.0)))
    x_set, x = (np.concatenate([truth[name] for truth in truths]) for name in ("xSet", "x"))
    return Course(x_set, x)


def side_by_side(
    seed: int, case: Case, axis: Axis, state: RigState, delay: int
) -> dict[str, Course]:
    """Return the course with each of the four feed-forwards."""
    fixed, living = copy.deepcopy(axis), copy.deepcopy(axis)
    fixed.plan = replace(fixed.plan, is_frozen=True)
    return {
        "PI alone": tracked(seed, case, state, "none", None, delay),
        "table": tracked(seed, case, state, "table", None, delay),
        "fixed map": tracked(seed, case, state, "external", fixed, delay),
        "living map": tracked(seed, case, state, "external", living, delay),
    }


def drawn(courses: Mapping[str, Course], file: str) -> None:
    """Draw set position, positions and errors of 20 s; the errors of PI alone leave the frame."""
    figure, (above, below) = plt.subplots(2, 1, figsize=(9, 5.5), sharex=True, layout="constrained")
    n = round(20 * RATE_HZ)
    t = np.arange(n) / RATE_HZ
    above.plot(t, next(iter(courses.values())).x_set[:n], "k--", lw=1, label="set position")
    for name, course in courses.items():
        above.plot(t, course.x[:n], lw=1, label=name)
        below.plot(t, (course.x - course.x_set)[:n], lw=1, label=f"{name}: {course.rms:.2f} mm RMS")
    above.set_ylabel("position in mm")
    most = 3.0 * courses["table"].rms
    below.set_ylim(-most, most)
    below.set_ylabel("tracking error in mm")
    below.set_xlabel("time in s")
    above.legend(fontsize=8)
    below.legend(fontsize=8, ncols=2)
    figure.savefig(file, dpi=110)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first", type=int, default=50)
    parser.add_argument("--delays", type=int, nargs="*", default=[1, 6])
    parser.add_argument("--picture")
    options = parser.parse_args()
    print(
        "seed  latency  case, RMS of the error in mm, living over fixed map and over table (bars)"
    )
    for seed in range(options.first, options.first + options.seeds):
        axis, state = commissioned(seed)
        for delay in options.delays:
            for case in cases(seed):
                courses = side_by_side(seed, case, axis, state, delay)
                rms = {name: course.rms for name, course in courses.items()}
                over = rms["living map"] / rms["fixed map"], rms["living map"] / rms["table"]
                errors = ", ".join(f"{name} {error:.2f}" for name, error in rms.items())
                shares = ", ".join(
                    f"{share:.2f}" if np.isnan(bar) else f"{share:.2f} (<= {bar})"
                    for share, bar in zip(over, case.bars, strict=True)
                )
                edges = " ".join(fault.edge or "" for fault in case.faults)
                print(
                    f"{seed} {10 * delay:3d} ms  {case.name} {edges}: {errors}; {shares}",
                    flush=True,
                )
                if options.picture and "edges" in case.name and delay == max(options.delays):
                    drawn(courses, options.picture)
                    options.picture = None


if __name__ == "__main__":
    main()
