"""Damage while a map is new: ``python -m benchmarks.early_damage [--first N] [--seeds N]``.

The rig's valve loses a share of its flow some seconds after the service saw it first; the figures
are how soon `Changed` names it, and how often `Changed` comes of undamaged valves. No
server, no clock: samples of the rig go to the default configuration's valve as they would live.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from valvemap.app.build import build_plans
from valvemap.config.models import Config
from valvemap.model.samples import Samples, Segments
from valvemap.pipeline.fleet import Fleet
from valvemap_rig.excitation import Cycle, Excitation, External, Scattered, Structured
from valvemap_rig.faults import commanded_fault
from valvemap_rig.scenario import Scenario, ValveBench
from valvemap_rig.simulation import Commands, RigState, advance, initial
from valvemap_rig.valvistor import Valvistor

START: Final = 1_800_000_000_000_000_000  # UTC ns
NAME: Final = "Valvistor"
BATCH: Final = 50  # samples; half a second, as they come live
WITHIN_S: Final = 10.0  # s from the damage to its alarm
AT_S: Final = (15.0, 25.0, 35.0, 65.0)  # s after the first sample
SIZES: Final = (-10.0, -20.0)  # %
WATCHED_S: Final = 30.0  # s after the damage
HEALTHY_S: Final = 100.0  # s
WORK: Final[dict[str, Excitation]] = {
    "cycle": Cycle(),
    "scattered": Scattered(hold_s=0.02),
    "held": Scattered(hold_s=0.5),
    "structured": Structured(sweep_s=5.0),
    "sweep": External(U_start_percent=60.0, p2_low_bar=40.0, p2_high_bar=180.0),
}
VALVES: Final = {
    "default": Valvistor(),
    "other": Valvistor(K_MP=5.0, spring_rate_N_mm=8.0, dead_band_percent=4.0),
}


@dataclass
class Line:
    """The rig, and behind it what the service makes of its samples."""

    scenario: Scenario
    rig: RigState
    fleet: Fleet
    time_s: float = 0.0

    @classmethod
    def of(cls, work: str, valve: str, seed: int) -> "Line":
        """Return a line that has seen nothing."""
        bench = ValveBench(name=NAME, valve=VALVES[valve])
        scenario = Scenario(seed=seed, valves=(bench,), excitation=WORK[work])
        config = Config(valves=[{"name": NAME, "estimators": [{"kind": "Auto"}]}])
        (plan,) = build_plans(config)
        return cls(scenario, initial(scenario, START), Fleet(plan, 1))

    def run(self, until_s: float, commands: Commands | None = None) -> Iterator[float]:
        """Advance by batches; give the time after each, s."""
        while self.time_s < until_s - 1e-9:
            self.rig, block = advance(self.scenario, self.rig, BATCH, commands)
            commands = None
            one = block.valves[NAME]
            worst = np.maximum.reduce(list(one.status.values())) >> 30
            sent = np.logical_and.reduce(list(one.present.values()))
            columns = one.t, one.U, one.p1, one.p2, one.Q, one.T
            samples = Samples.of(*columns, np.minimum(worst, 2))[sent]
            self.fleet.take(samples, Segments.one(len(samples)))
            self.time_s += BATCH / self.scenario.sample_rate_hz
            yield self.time_s

    def text(self) -> str:
        """The text of `Changed`, empty if it is not active."""
        active = (r.text for r in self.fleet.alarms.reports(0) if r.name == "Changed" and r.active)
        return next(active, "")


def damaged(line: Line, at_s: float, size: float) -> tuple[float | None, bool, bool]:
    """Seconds until the alarm, whether it names the edge, whether one came before."""
    for _ in line.run(at_s):
        pass
    if line.text():
        return None, False, True
    fault = commanded_fault("damage", size, 0.0)
    for now in line.run(at_s + WATCHED_S, Commands(faults=((NAME, fault),))):
        if text := line.text():
            return now - at_s, "edge" in text, False
    return None, False, False


def healthy(line: Line) -> list[float]:
    """Times at which `Changed` was raised, s."""
    came: list[float] = []
    for now in line.run(HEALTHY_S):
        if not came and line.text():
            came.append(now)
    return came


def main(arguments: Sequence[str] | None = None) -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=71_000)
    parser.add_argument("--seeds", type=int, default=3)
    given = parser.parse_args(arguments)
    seeds = range(given.first, given.first + given.seeds)
    print("| damage | at, s | within 10 s | edge named | median, s | not found | alarm before |")
    print("|---|---|---|---|---|---|---|")
    for work in WORK:
        for at_s in AT_S:
            found = [
                damaged(Line.of(work, valve, seed), at_s, size)
                for valve in VALVES
                for size in SIZES
                for seed in seeds
            ]
            late = sorted(f[0] for f in found if f[0] is not None)
            soon = sum(x <= WITHIN_S for x in late)
            named, before = sum(f[1] for f in found), sum(f[2] for f in found)
            median = f"{late[len(late) // 2]:.1f}" if late else "-"
            row = f"{soon} of {len(found)} | {named} | {median}"
            missed = len(found) - len(late) - before
            print(f"| {work} | {at_s:.0f} | {row} | {missed} | {before} |", flush=True)
    print("\n| healthy | runs | with an alarm | first at, s |")
    print("|---|---|---|---|")
    for work in WORK:
        runs = [
            healthy(Line.of(work, valve, seed))
            for valve in VALVES
            for seed in range(given.first, given.first + 2 * given.seeds)
        ]
        came = [f"{run[0]:.0f}" for run in runs if run]
        print(f"| {work} | {len(runs)} | {len(came)} | {', '.join(came)} |", flush=True)


if __name__ == "__main__":
    main()
