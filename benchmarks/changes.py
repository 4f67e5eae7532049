"""How soon damage is found, and how often a change is called where nothing changes.

Cells of `benchmarks.honest_maps`. -10 % of the flow after 10,000 samples and more, in white noise,
counted in samples with Q > 10 l/min until the change is published; and changes called in 300,000
healthy samples of each circumstance.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final

import numpy as np

from benchmarks import circumstances as c
from benchmarks.cells import Cell, Figures, Judged
from benchmarks.coverage import AUTO, RLS

BEFORE, FLOW, WITHIN, AFTER = 10_000, 10.0, 100, 3_000  # samples, l/min, samples, samples
STEP: Final = 5  # samples per batch after the damage
HEALTHY: Final = 300_000  # samples
Points = Callable[[int, int], tuple[np.ndarray, np.ndarray]]


def damage(estimator: Any, valve: c.Valve, points: Points, seed: int) -> Figures:
    """Samples with Q > 10 l/min from the damage to its publication; none where it was not."""
    at = BEFORE + 1_700 * (seed % 10)
    U, dp = points(seed, at + AFTER)
    flow = valve(U, dp) * np.where(np.arange(len(U)) < at, 1.0, 0.9)
    samples = c.samples_of(U, dp, flow + c.white(seed, len(U)))
    state, _ = estimator.update(estimator.initial_state(), samples[:at])
    false = _count(estimator, state)
    for first in range(at, len(U), STEP):
        state, _ = estimator.update(state, samples[first : first + STEP])
        if _count(estimator, state) > false:
            seen = int((flow[at : first + STEP] > FLOW).sum())
            return {"found": seen, "false": false}
    return {"found": None, "false": false}


def judge_damage(found: Sequence[Figures]) -> Judged:
    """Share in time, and how late."""
    late = [f["found"] for f in found]
    in_time = sum(x is not None and x <= WITHIN for x in late)
    known = sorted(x for x in late if x is not None)
    false = sum(f["false"] for f in found)
    figure = f"{in_time} of {len(late)} in time"
    if known:
        figure += f", median {known[len(known) // 2]}, latest {known[-1]}"
    if len(known) < len(late):
        figure += f", {len(late) - len(known)} not within {AFTER}"
    figure += f", {false} false before" if false else ""
    return Judged(figure, f"all within {WITHIN} samples", in_time == len(late) and not false)


def healthy(kind: str, seed: int) -> Figures:
    """Changes called of both estimators."""
    N, T = HEALTHY, 40.0
    U, dp = c.cycle(seed, N)
    noise, valve = c.white(seed, N), c.ordinary
    match kind:
        case "closed loop":
            U, dp, Q = c.closed_loop(seed, N, valve)
        case "misfit":
            Q = c.s_shape(U, dp) + noise
        case "warming":
            T = c.warming(N)
            Q = c.warm(valve)(U, dp, T) + noise
        case "AR(.95)":
            Q = valve(U, dp) + c.ar(seed, N)
        case _:
            Q = valve(U, dp) + noise
    samples, found = c.samples_of(U, dp, Q, T), {}
    for name, estimator in (("RLS", RLS), ("Auto", AUTO)):
        state, _ = estimator.update(estimator.initial_state(), samples)
        found[name] = _count(estimator, state)
    return found


def judge_healthy(found: Sequence[Figures]) -> Judged:
    """None of either."""
    counts = {name: sum(f[name] for f in found) for name in ("RLS", "Auto")}
    figure = f"RLS {counts['RLS']}, Auto {counts['Auto']} called"
    return Judged(figure, "0 in 20 × 300,000", not any(counts.values()))


def cells() -> Mapping[str, Cell]:
    """Damage by points, estimator and valve; then the healthy ones."""
    found = {
        f"-10 %, {title}, {name} on {valve}": Cell(
            10, partial(damage, estimator, c.VALVES[valve], points), judge_damage
        )
        for title, points in (("cycle", c.cycle), ("scattered", c.scattered))
        for name, estimator in (("RLS", RLS), ("Auto", AUTO))
        for valve in c.VALVES
    }
    for kind in ("white", "AR(.95)", "closed loop", "misfit", "warming"):
        found[f"healthy, {kind}"] = Cell(20, partial(healthy, kind), judge_healthy)
    return found


def _count(estimator: Any, state: Any) -> int:
    change = estimator.last_change(state)
    return change.count if change else 0
