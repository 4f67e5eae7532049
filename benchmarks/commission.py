"""Commissioning in simulation: ``python -m benchmarks.commission [--seeds N] [--faults N]``.

*Map*: RMSE over the whole range (U, Δp 5 … 193 bar) in σ of the noise (.4 l/min) after 30 and 60 s,
on ten unlike valves: the run as `valvemap commission` makes it, its triangles alone, machine work
and steps of U, all with the same estimator. *Faults*: runs with one fault each; what was written is
checked against range and slew, the reaction and the way to the safe U are timed. ``--report`` takes
the seeds that nothing is tuned on.
"""

import argparse
import sys
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np

from benchmarks import circumstances as c
from benchmarks.commission_plant import (
    MISSED,
    SAMPLE_S,
    VALVES,
    Happening,
    Loop,
    Plant,
    Valve,
    samples_of,
    settings_for,
)
from benchmarks.one_model_rows import behind
from valvemap.config.estimators import AutoConfig, build_estimator
from valvemap.vocabulary.commission import Phase

REPORT: Final = 97_000
TIMES: Final = (30.0, 60.0)
BARS: Final = {30.0: 0.5, 60.0: 0.3}
KINDS: Final = (
    *("source lost", "stale", "pump limit", "stuck spool", "operator gone", "process killed"),
    *("abort", "bad samples", "pressure", "refused", "terminal gone", "none"),
)
MORE_KINDS: Final = ("U stands",)  # with --kind alone
GO_ON: Final = {"pump limit", "refused", "none", "U stands"}  # safe U not wanted, or not taken
QUANTILES: Final = (0.25, 0.5, 0.75, 0.9)
BY_MAP: Final = {"stuck spool", "none"}  # runs that learn
WATCHED: Final = {"process killed"}  # by the source's watchdog alone


def estimator_of(valve: Valve) -> Any:
    """The estimator that a run learns with: `Auto`."""
    return build_estimator(AutoConfig(), valve.U_range, (0.0, 200.0), (0.0, 200.0))


def error(valve: Valve, estimator: Any, state: Any) -> float:
    """RMSE over the whole range, σ; infinite where the map is not known."""
    axes = np.linspace(*valve.U_range, 41), np.linspace(5.0, 193.0, 21)
    U, dp = (x.ravel() for x in np.meshgrid(*axes))
    Q, _ = estimator.predict(state, U, dp, np.full(len(U), 40.0))
    found = c.rms(Q - valve.flow(U, dp)) / c.SIGMA
    return found if np.isfinite(found) else np.inf


def driven(valve: Valve, seed: int, seconds: float, sweep: float) -> float:
    """A run of ``seconds``, of which the share ``sweep`` are triangles."""
    estimator = estimator_of(valve)
    settings = settings_for(valve, sweep_s=sweep * seconds, most_s=seconds)
    loop = Loop(Plant(valve, seed), settings, estimator=estimator).run(seconds + 5.0)
    return error(valve, estimator, loop.catch_up().state)


def unled(valve: Valve, seed: int, seconds: float, *, steps: bool) -> tuple[Any, Any]:
    """U and Δp of machine work, or of steps of U from below at a swept load, as in the paper."""
    N = round(seconds * c.FS)
    low, high = valve.U_range
    if not steps:
        return c.cycle(seed, N, valve.U_range)
    levels = low + (high - low) * np.arange(11) / 10.0
    U = levels[np.minimum(np.arange(N) * 11 // N, 10)]
    return U, 99.0 + 96.0 * np.sin(2.0 * np.pi * np.arange(N) / c.FS / 2.6)


def undriven(valve: Valve, seed: int, seconds: float, *, steps: bool) -> float:
    """Machine work, or steps."""
    U, dp = unled(valve, seed, seconds, steps=steps)
    N = len(U)
    Q = valve.flow(behind(U, valve.play), dp) + c.white(seed, N)
    rows = np.column_stack([np.arange(N) / c.FS, U, dp, np.zeros(N), Q])
    estimator = estimator_of(valve)
    state, _ = estimator.update(estimator.initial_state(), samples_of(list(map(tuple, rows))))
    return error(valve, estimator, state)


def maps(seeds: Sequence[int], only: str = "") -> None:
    """Print the table of maps; ``only`` the columns whose name begins so."""
    print("RMSE in σ after 30 s / 60 s, median (largest) over the seeds")
    for name, valve in VALVES.items():
        line, held = [], True
        for what, how in (
            ("commission", lambda s, T, v=valve: driven(v, s, T, 0.4)),
            ("triangles", lambda s, T, v=valve: driven(v, s, T, 1.0)),
            ("machine work", lambda s, T, v=valve: undriven(v, s, T, steps=False)),
            ("steps", lambda s, T, v=valve: undriven(v, s, T, steps=True)),
        ):
            if not what.startswith(only):
                continue
            found = {T: [how(seed, T) for seed in seeds] for T in TIMES}
            cells = [f"{np.median(f):.2f} ({max(f):.2f})" for f in found.values()]
            line.append(f"{what} {' / '.join(cells)}")
            if what == "commission":
                held = all(np.median(found[T]) <= BARS[T] for T in TIMES)
        print(f"{name}: {', '.join(line)}: {'holds' if held else 'MISSES the bar'}", flush=True)


def fault(seed: int, kind: str = "") -> dict[str, Any]:
    """One run with one fault at a random time, of a kind by the seed if none is given."""
    rng = np.random.default_rng([seed, 17])
    valve = list(VALVES.values())[seed % len(VALVES)]
    kind = kind or KINDS[(seed // len(VALVES)) % len(KINDS)]
    at = float(rng.uniform(2.0, 12.0))
    lasts = {"source lost": 3.0, "stale": 2.0, "bad samples": 2.0, "refused": 0.3}.get(kind, np.inf)
    whole = {} if kind == "none" else {"sweep_s": 10.0, "most_s": 15.0}
    settings = settings_for(valve, **whole)
    estimator = estimator_of(valve) if kind in BY_MAP else None
    loop = Loop(Plant(valve, seed), settings, Happening(kind, at, lasts), estimator).run(75.0)
    before = len(loop.log.rows)
    if kind == "process killed":
        for k in range(round(at / SAMPLE_S) + 1, round((at + 2.0) / SAMPLE_S)):
            loop.log.U.append((k * SAMPLE_S, loop.plant.sample(k * SAMPLE_S)[0]))
        loop = Loop(loop.plant, settings, None, before=loop, begin_s=at + 2.0).run(45.0)
    limits = settings.limits
    beyond = _is_beyond(loop.log.writes, valve.U_range, limits.slew_percent_per_s)
    load_range = limits.load_range or (-np.inf, np.inf)
    beyond |= _is_beyond(loop.log.loads, load_range, limits.load_slew_bar_per_s)
    drives = {Phase.SWEEPING, Phase.REFINING}
    notable = [when for when, phase, _ in loop.log.phases if when >= at and phase not in drives]
    if kind == "operator gone":  # counted from the first sign that did not come
        at = loop.due
    first = min(notable, default=np.inf)
    if kind == "pump limit":  # U turns towards the safe one
        after = [(when, u) for when, u in loop.log.writes if when >= at]
        first = _retreat(loop, at, after)
    at_U = np.array(loop.log.U)
    if kind == "stuck spool":  # the sweep itself passes the safe U
        at_U = at_U[at_U[:, 0] >= first]
    safe = at_U[(at_U[:, 0] >= at) & (np.abs(at_U[:, 1]) < 1.0), 0]
    return {
        "kind": kind,
        "beyond": beyond,
        "reaction": first - at,
        "since seen": first - loop.plant.missed,
        "safe": float(safe[0] - at) if len(safe) else np.inf,
        "end": loop.state.phase,
        "kept": len(loop.log.rows) >= before,
    }


def _is_beyond(
    written: list[tuple[float, float]], bounds: tuple[float, float], slew: float
) -> bool:
    """Whether commands left their range or slew; a pause begins anew from what is measured."""
    t, x = np.array(written).T
    steep = np.abs(np.diff(x)) > slew * np.diff(t) + 1e-9
    again = np.diff(t) > 1.5  # s
    return bool(x.min() < bounds[0] or x.max() > bounds[1] or (steep & ~again).any())


def _retreat(loop: Loop, at: float, after: list[tuple[float, float]]) -> float:
    """Time at which |U| first fell after p1 or Q left its limits; ``at`` if they never did."""
    limits = loop.settings.limits
    outside = [row[0] for row in loop.log.rows if row[0] >= at and row[2] < limits.p1_range[0]]
    if not outside:
        return at
    falls = [
        t1
        for (_, u0), (t1, u1) in pairwise(after)
        if t1 >= outside[0] and (abs(u1) < abs(u0) or abs(u1) < 1.0)
    ]
    return at + (falls[0] - outside[0] if falls else np.inf)


def faults(seeds: Sequence[int], only: str = "") -> None:
    """Print a line per kind of fault."""
    found = [fault(seed, only) for seed in seeds]
    print(f"{len(found)} runs; U, load or slew beyond limits in {sum(f['beyond'] for f in found)}")
    for kind in (*KINDS, *MORE_KINDS):
        own = [f for f in found if f["kind"] == kind]
        if not own:
            continue
        ends = {
            p.name: sum(f["end"] is p for f in own)
            for p in Phase
            if any(f["end"] is p for f in own)
        }
        reaction = ""
        if kind not in {*WATCHED, "none"}:
            reaction = f"reaction ≤ {max(f['reaction'] for f in own):.2f} s, "
        if kind in {"stuck spool", "U stands"}:
            since = (f" since {MISSED:g} l/min miss", "since seen")
            for what, key in (("", "reaction"), *([since] if kind == "stuck spool" else [])):
                spread = ", ".join(
                    f"{x:.2f}" for x in np.quantile([f[key] for f in own], QUANTILES)
                )
                reaction += f"at quantiles {QUANTILES}{what} {spread} s, "
        safe = "" if kind in GO_ON else f"safe U ≤ {max(f['safe'] for f in own):.2f} s, "
        print(
            f"{kind}: {len(own)} runs, {reaction}{safe}"
            f"nothing lost {all(f['kept'] for f in own)}, ends {ends}",
            flush=True,
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=0, help="of the maps")
    parser.add_argument("--faults", type=int, default=0, help="runs with a fault")
    parser.add_argument("--report", action="store_true", help="seeds that nothing is tuned on")
    parser.add_argument("--first", type=int, help="first seed, in place of these")
    parser.add_argument("--kind", default="", choices=("", *KINDS, *MORE_KINDS))
    parser.add_argument("--only", default="", help="columns of the maps: the first letters")
    wanted = parser.parse_args(arguments)
    first = (REPORT if wanted.report else 0) if wanted.first is None else wanted.first
    if wanted.faults:
        faults(range(first, first + wanted.faults), wanted.kind)
    if wanted.seeds:
        maps(range(first, first + wanted.seeds), wanted.only)
    return 0


if __name__ == "__main__":
    sys.exit(main())
