"""Tracking error of a cylinder with four feed-forwards, on the rig, with latency.

``python -m benchmarks.axis_tracking [--seeds 2] [--first 50] [--picture FILE]``: one table of
`paper.motion`, which the paper's report judges, too. Each seed is another valve, load and
programme. Beside the four stands the true map of the valve as it is, in the same inverse: no map
can be better by more than chance, so that where it misses a bar, the bar asks for more than a map.
The first row of a delay has the 6 s in which the maps take over from the table.
``--picture`` draws the four after the damage, at the first seed, with the longest delay. ``--lead``
compares both maps with and without the lead by the spool found instead, beside the table, of valves
whose spool is drawn from 8 to 25 Hz.
"""

import argparse
import copy
from collections.abc import Mapping
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

from benchmarks.axis import machine
from paper.motion import (
    EDGES,
    GEOMETRY,
    RATE_HZ,
    SETTLED_S,
    Case,
    Course,
    cases,
    commissioned,
    scenario_of,
    side_by_side,
    tracked,
)
from valvemap.model.axis_inverse import STEP_PERCENT, AxisTable
from valvemap.model.kernels.axis_edges import ROOT
from valvemap.pipeline.axes import Axis
from valvemap.pipeline.axis_jobs import solved
from valvemap.pipeline.axis_plan import AxisPlan
from valvemap.pipeline.axis_ports import RequiredU
from valvemap.pipeline.feedforward import FeedForward
from valvemap.pipeline.kept_axes import Learnt
from valvemap_rig.directional import true_edge_flow
from valvemap_rig.faults import FaultKind
from valvemap_rig.machine import Machine

SLOW_HZ = (8.0, 25.0)  # range of the spools whose delay is worth a lead
TAKE_OVER = Case("take-over from the table", (), 0.0, SETTLED_S, (np.nan, np.nan))


def slow_spool(seed: int) -> Machine:
    """Return the axis of a seed with a slow spool."""
    drawn = machine(seed)
    hz = float(np.random.default_rng([seed, 1]).uniform(*SLOW_HZ))
    valve = drawn.valve.model_copy(update={"natural_frequency_hz": hz})
    return drawn.model_copy(update={"valve": valve})


def leading(axis: Axis) -> Axis:
    """Return a copy of an axis whose demand is advanced by the delay of its spool."""
    other = copy.deepcopy(axis)
    other.plan = replace(axis.plan, feed_forward=FeedForward((-100.0, 100.0), leads=True))
    return other


def frozen(axis: Axis) -> Axis:
    """Return a copy of an axis that learns no more."""
    other = copy.deepcopy(axis)
    other.plan = replace(axis.plan, is_frozen=True)
    return other


def true_table(seed: int, of: Machine, case: Case) -> AxisTable:
    """Return the table of the true edges, as damaged as they are in a case."""
    y = np.arange(0.0, 100.0 + STEP_PERCENT / 2.0, STEP_PERCENT)
    passes = dict.fromkeys(EDGES, 1.0)
    for fault in case.faults:
        if fault.kind is FaultKind.DAMAGE and fault.edge is not None:
            passes[fault.edge] *= 1.0 + 0.01 * fault.size
    K = np.stack([true_edge_flow(of.valve, e, y, ROOT**2, passes[e]) / ROOT for e in EDGES])
    leakage = scenario_of(seed, "external", of).machines[0].cylinder.leakage_l_min_bar
    exact, known, play = np.zeros_like(K), np.full(len(EDGES), y[-1]), of.valve.play_percent
    return AxisTable(GEOMETRY, y, K, exact, exact, known, leakage, play)


class ByTable(Axis):
    """An axis that learns nothing, and answers by a table."""

    def __init__(self, learnt: Learnt, plan: AxisPlan, table: AxisTable) -> None:
        super().__init__(replace(plan, is_frozen=True))
        known = solved(learnt.regression, learnt.state, learnt.of_shape)
        self._known = replace(known, table=table)

    def required(self) -> RequiredU:
        """Return the signal for the demanded speed at the newest sample's pressures."""
        return self._demand.required(self._known, self.t, self._newest)


def compare_lead(seed: int, delays: list[int]) -> None:
    """Print a seed's errors with and without lead, beside the table's and the fixed maps'."""
    slow = slow_spool(seed)
    axis, state = commissioned(seed, slow)
    hz = slow.valve.natural_frequency_hz
    print(f"{seed} spool {hz:.1f} Hz, lead {1e3 * leading(axis).lead_s:.0f} ms", flush=True)
    for case in cases(seed):
        table = tracked(seed, slow, case, state, "table", None, 0).rms
        for delay in delays:
            errors = {
                name: tracked(seed, slow, case, state, "external", one, delay).rms
                for name, one in (
                    ("fixed map", frozen(axis)),
                    ("fixed map with lead", frozen(leading(axis))),
                    ("living map", copy.deepcopy(axis)),
                    ("living map with lead", leading(axis)),
                )
            }
            led = errors["living map with lead"]
            over = {
                "living map": (led / errors["living map"], 1.0),
                "fixed map with lead": (led / errors["fixed map with lead"], case.bars[0]),
                "table": (led / table, case.bars[1]),
            }
            listed = ", ".join(f"{name} {error:.2f}" for name, error in errors.items())
            shares = ", ".join(f"{shown(*one)} of the {name}" for name, one in over.items())
            print(
                f"{seed} {10 * delay:3d} ms  {case.name}: table {table:.2f}, {listed}; {shares}",
                flush=True,
            )


def shown(share: float, bar: float) -> str:
    """Return a share with its bar, where there is one."""
    return f"{share:.2f}" if np.isnan(bar) else f"{share:.2f} (<= {bar})"


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
    parser.add_argument("--only", default="", help="part of the names of the cases")
    parser.add_argument("--picture")
    parser.add_argument("--lead", action="store_true")
    options = parser.parse_args()
    if options.lead:
        for seed in range(options.first, options.first + options.seeds):
            compare_lead(seed, options.delays)
        return
    print(
        "seed  latency  case, RMS of the error in mm, living over fixed map and over table (bars); "
        "the same of the true map"
    )
    for seed in range(options.first, options.first + options.seeds):
        drawn_machine = machine(seed)
        axis, state = commissioned(seed, drawn_machine)
        if (learnt := axis.learner.learnt) is None:
            print(f"{seed} {axis.results().sentence}", flush=True)
            continue
        for delay in options.delays:
            for case in (one for one in (TAKE_OVER, *cases(seed)) if options.only in one.name):
                courses = side_by_side(seed, drawn_machine, case, axis, state, delay)
                true_map = ByTable(learnt, axis.plan, true_table(seed, drawn_machine, case))
                best = tracked(seed, drawn_machine, case, state, "external", true_map, delay)
                rms = {name: course.rms for name, course in courses.items()}
                over = rms["living map"] / rms["fixed map"], rms["living map"] / rms["table"]
                of_true = best.rms / rms["fixed map"], best.rms / rms["table"]
                errors = ", ".join(f"{name} {error:.2f}" for name, error in rms.items())
                shares = ", ".join(map(shown, over, case.bars))
                edges = " ".join(fault.edge or "" for fault in case.faults)
                print(
                    f"{seed} {10 * delay:3d} ms  {case.name} {edges}: {errors}; {shares}; "
                    f"true map {best.rms:.2f}, {of_true[0]:.2f}, {of_true[1]:.2f}",
                    flush=True,
                )
                if options.picture and "edges" in case.name and delay == max(options.delays):
                    drawn(courses, options.picture)
                    options.picture = None


if __name__ == "__main__":
    main()
