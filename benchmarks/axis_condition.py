"""Causes of changes of an axis: edges, leakage, air, on the rig.

``python -m benchmarks.axis_condition [--seeds 3] [--first 700] [--hours 1]``: one row a seed. Each
seed is another valve, cylinder and sensor (`benchmarks.axis`). After 300 s of identification, and
130 s with nothing, each fault begins at a random moment; what is likeliest 60 s later counts. Then
comes healthy work for ``--hours``, in which each listed finding is false. ``--speed``: the speed is
measured in place of the position, as in ``benchmarks.axis``. ``--away``: until the faults the axis
uses the lowest third of its stroke alone, in the healthy work all of it, then the highest third.
``--healthy``: without the faults.
"""

import argparse
from collections.abc import Iterator, Sequence
from itertools import cycle, islice

import numpy as np

from benchmarks.axis import GEOMETRY, NOISES_MM, machine, samples, with_speed
from valvemap.model.axis import AxisSamples
from valvemap.model.axis_condition import CAUSES
from valvemap.model.axis_search import identify
from valvemap.model.axis_travel import Travel
from valvemap.pipeline.axis_watch import AxisWatch, balance
from valvemap.vocabulary.findings import FindingCode
from valvemap_rig.faults import Fault
from valvemap_rig.scenario import Scenario
from valvemap_rig.simulation import Commands, RigState, advance, initial

MEMORY_S = 1_800.0
BATCH = 50  # samples
LOWEST, ALL, HIGHEST = (0.08, 0.36), (0.08, 0.92), (0.64, 0.92)
"""Shares of the stroke between which the places are."""
FAULTS = {
    **{
        f"{edge} -10 %": (Fault(kind="damage", edge=edge, size=-10), code)
        for edge, code in (
            ("PA", FindingCode.PA_CHANGE),
            ("AT", FindingCode.AT_CHANGE),
            ("PB", FindingCode.PB_CHANGE),
            ("BT", FindingCode.BT_CHANGE),
        )
    },
    "leakage x 3": (Fault(kind="leakage", size=2), FindingCode.LEAKAGE_CHANGE),
    "air 2 %": (Fault(kind="air", size=2), FindingCode.AIR),
    "air 5 %": (Fault(kind="air", size=5), FindingCode.AIR),
    "air 10 %": (Fault(kind="air", size=10), FindingCode.AIR),
    "x lags 0.1 s": (Fault(kind="lag", signal="x", size=0.1), FindingCode.MISFIT),
    "friction x 2": (Fault(kind="friction", size=100), FindingCode.FRICTION),
    "load x 2": (Fault(kind="load", size=100), None),
}
"""With the code that is right; None: it is not told."""
TWO = ("PA and BT -30 %", ("PA", "BT"), (FindingCode.PA_CHANGE, FindingCode.BT_CHANGE))
"""Two edges at once: both must come before all else."""


class Run:
    """A seed's rig and its watch."""

    def __init__(self, seed: int, *, speed: bool = False, away: bool = False) -> None:
        self.travel = Travel.initial() if speed else None
        self.noise_mm = NOISES_MM[seed % 3]
        axis = machine(seed, self.noise_mm)
        self.scenario = Scenario(seed=seed, valves=(), machines=(axis,), sample_rate_hz=100.0)
        if away:
            self.within(LOWEST)
        self.rig, block = self.played(initial(self.scenario, 0), 300.0)
        found = identify(block, GEOMETRY)
        if found.status or found.fit is None or found.state is None or found.of_shape is None:
            raise SystemExit(f"seed {seed}: {found.sentence}")
        forces = balance(found.fit, block)
        self.watch = AxisWatch.begin(found.state, found.fit, MEMORY_S, found.of_shape, forces)

    def within(self, shares: Sequence[float]) -> None:
        """Let the axis work between these shares of its stroke from now on."""
        (axis,) = self.scenario.machines
        low, high = shares
        programme = axis.programme.model_copy(update={"low": low, "high": high})
        machines = (axis.model_copy(update={"programme": programme}),)
        self.scenario = self.scenario.model_copy(update={"machines": machines})

    def healthy(self, rig: RigState, *, away: bool) -> Iterator[AxisSamples]:
        """Yield healthy work without end; ``away`` continues in other parts of the stroke."""
        before = np.array(LOWEST)
        for after in cycle((ALL, HIGHEST, LOWEST)):
            for k in range(100):  # of 6 s, two moves each
                if away and k <= 20:
                    self.within(before + k / 20.0 * (after - before))
                rig, work = self.played(rig, 6.0)
                yield work
            before = np.array(after)

    def played(self, rig: RigState, seconds: float, *faults: Fault) -> tuple[RigState, AxisSamples]:
        """Return rig and samples of so many seconds more."""
        given = Commands(faults=tuple(("Axis", fault) for fault in faults))
        rig, block = advance(self.scenario, rig, round(100 * seconds), given)
        found = block.machines["Axis"]
        if self.travel is None:
            return rig, samples(found)
        work = samples(with_speed(found, self.scenario.seed))
        self.travel, placed = self.travel.update(work, GEOMETRY.stroke_mm)
        return rig, placed


def watched(watch: AxisWatch, work: AxisSamples) -> Iterator[AxisWatch]:
    """Yield the watch after each window, and at the end."""
    for start in range(0, len(work), BATCH):
        watch = watch.after(work[start : start + BATCH])
        if watch.closed:
            watch = watch.weighed()
            yield watch
    yield watch


def last(watch: AxisWatch, work: AxisSamples) -> AxisWatch:
    """Return the watch at the end."""
    for after in watched(watch, work):
        watch = after
    return watch


def ranked(watch: AxisWatch) -> list[FindingCode | None]:
    """Return what is likeliest, None: nothing has changed."""
    codes: list[FindingCode | None] = [None, *CAUSES]
    return [codes[k] for k in np.argsort(-watch.condition.of_causes)]


def said(watch: AxisWatch) -> str:
    """Return the findings with their probabilities."""
    found = watch.condition.findings()
    return "; ".join(f"{one.probability:.2f} {one.sentence}" for one in found) or "nothing"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=700)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--speed", action="store_true")
    parser.add_argument("--away", action="store_true")
    parser.add_argument("--healthy", action="store_true")
    options = parser.parse_args()
    exact: dict[str, list[bool]] = {name: [] for name in (*FAULTS, TWO[0])}
    within: dict[str, list[bool]] = {name: [] for name in (*FAULTS, TWO[0])}
    false, windows = 0, 0
    for seed in range(options.first, options.first + options.seeds):
        run = Run(seed, speed=options.speed, away=options.away)
        moment_s = 130.0 + np.random.default_rng(seed).uniform(0.0, 10.0)
        rig, work = run.played(run.rig, moment_s)
        watch = last(run.watch, work)
        there, answers = run.travel, []
        for name, (fault, right) in ({} if options.healthy else FAULTS).items():
            run.travel = there
            _, work = run.played(rig, 60.0, fault)
            after = last(watch, work)
            order = ranked(after)
            exact[name].append(order[0] is right)
            within[name].append(right in order[:2])
            answers.append(f"    {name}: {said(after)}")
        for name, edges, rights in () if options.healthy else (TWO,):
            run.travel = there
            both = (Fault(kind="damage", edge=edge, size=-30) for edge in edges)
            _, work = run.played(rig, 60.0, *both)
            after = last(watch, work)
            order = ranked(after)
            exact[name].append(set(order[:2]) == set(rights))
            within[name].append(set(rights) <= set(order[:3]))
            answers.append(f"    {name}: {said(after)}")
        worst, run.travel = 1.0, there
        for work in islice(run.healthy(rig, away=options.away), round(600 * options.hours)):
            for after in watched(watch, work):
                is_weighed = after.condition is not watch.condition
                watch = after
                if not is_weighed:
                    continue
                windows += 1
                worst = min(worst, watch.condition.unchanged)
                if watch.condition.findings():
                    false += 1
                    print(f"    false: {said(watch)}", flush=True)
        print(f"{seed} {run.noise_mm} mm: least probability of unchanged {worst:.3f}", flush=True)
        print("\n".join(answers), flush=True)
    print("fault            exact  within two")
    for name, found in ({} if options.healthy else exact).items():
        print(f"{name:16s} {np.mean(found):5.2f} {np.mean(within[name]):5.2f}")
    hours = options.hours * options.seeds
    print(f"healthy: {false} of {windows} windows with a finding, in {hours:g} h")


if __name__ == "__main__":
    main()
