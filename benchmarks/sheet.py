"""Sheets of known valves: ``python -m benchmarks.sheet [--seeds N] [--report] [--valve NAME]``.

*Guided*: 60 s, two triangles of U of 5 s and one of 50 s, those of the load of 8.1 s. *Classic*:
120 s at constant Δp, triangles of 60 s; both are read by `make_sheet`. For each figure: its spread
over seeds (standard deviation, RMS over valves), the same of the classic sweep, their ratio, the
error with what all seeds have in common, and how often the 95 % interval holds the truth. The plant
has the spool that the fit assumes: play, and a lag of first order. ``--report`` takes the seeds
that nothing is tuned on.
"""

import argparse
from collections import defaultdict
from typing import Final

import numpy as np

from benchmarks.circumstances import SIGMA
from benchmarks.commission_plant import VALVES, Valve
from valvemap.model.samples import Samples
from valvemap.model.sheet import Measured, make_sheet, name_of
from valvemap.model.sheet_figures import GRID, OF_SIDES, OF_VALVE, Side
from valvemap.model.sweep_equations import spool
from valvemap.pipeline.commission_limits import Limits
from valvemap.pipeline.commission_plan import Plan, sweep

REPORT: Final = 83_000
RATED_BAR: Final = 70.0
SUPPLY: Final = 200.0
LOADS: Final = (5.0, 197.0)
RATE_HZ: Final = 100
GUIDED = Plan(period_s=5.0, sweep_s=60.0, last_period_s=50.0)
CLASSIC = Plan(period_s=60.0, sweep_s=120.0)


def swept(
    valve: Valve,
    seed: int,
    *,
    classic: bool = False,
    lag_s: float = 0.005,
    guided: Plan = GUIDED,
) -> Samples:
    """Samples of a sweep of one valve."""
    plan, limits = CLASSIC if classic else guided, Limits(valve.U_range, load_range=LOADS)
    t = np.arange(round(plan.sweep_s) * RATE_HZ) / RATE_HZ
    points = [sweep(plan, limits, at) for at in t.tolist()]
    U, load = np.array([(point.U, point.load) for point in points]).T
    if classic:
        load = np.full(len(t), SUPPLY - RATED_BAR)
    rng = np.random.default_rng([seed, 3])
    x = spool(U, np.full(len(t), 1.0 / RATE_HZ), valve.play, lag_s)
    Q = valve.flow(x, SUPPLY - load) + rng.normal(0.0, SIGMA, len(t))
    p1, p2 = (p + rng.normal(0.0, 0.05, len(t)) for p in (np.full(len(t), SUPPLY), load))
    return Samples.of(t=np.rint(t * 1e9).astype(np.int64), U=U, p1=p1, p2=p2, Q=Q)


def truth_of(valve: Valve) -> dict[tuple[str, str], float]:
    """Figures of the valve's true curve, by key and side."""
    ends = sorted((end for end in valve.U_range if end != 0.0), reverse=True)
    play, x = valve.play, np.linspace(0.0, max(map(abs, valve.U_range)), GRID)
    first, top = (int(np.searchsorted(x, at)) for at in (0.5 * play, x[-1] - 0.5 * play))
    sides = tuple(
        Side(
            x,
            np.sign(end) * valve.flow(np.sign(end) * x, dp)[None, :],
            np.array([play]),
            first,
            top,
        )
        for end in ends
        for dp in [np.full(GRID, RATED_BAR)]
    )
    found = {
        (row.key, name_of(end, len(ends))): float(row.of((side,))[0])
        for end, side in zip(ends, sides, strict=True)
        for row in OF_SIDES
    }
    whole = {(row.key, ""): float(row.of(sides)[0]) for row in OF_VALVE if row.sides <= len(sides)}
    return found | whole


def main() -> None:
    """Run the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.sheet")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--report", action="store_true")
    parser.add_argument("--first", type=int, help="first seed, in place of these")
    parser.add_argument("--valve", default="", help="valves whose names begin so")
    chosen = parser.parse_args()
    first = (REPORT if chosen.report else 0) if chosen.first is None else chosen.first
    spread: dict[tuple[str, bool], list[float]] = defaultdict(list)
    errors: dict[tuple[str, bool], list[float]] = defaultdict(list)
    held: dict[tuple[str, bool], list[bool]] = defaultdict(list)
    for valve in (one for name, one in VALVES.items() if name.startswith(chosen.valve)):
        truth = truth_of(valve)
        for classic in (False, True):
            found: dict[tuple[str, str], list[float]] = defaultdict(list)
            for seed in range(first, first + chosen.seeds):
                samples = swept(valve, seed, classic=classic)
                sheet = make_sheet(samples, RATED_BAR, valve.U_range)
                for figure in sheet.figures:
                    true = truth.get((figure.key, figure.side), np.nan)
                    if figure.measured is Measured.MEASURED and np.isfinite(true):
                        found[figure.key, figure.side].append(figure.value)
                        held[figure.key, classic].append(figure.lower <= true <= figure.upper)
                        errors[figure.key, classic].append(figure.value - true)
            for (key, _), values in found.items():
                if len(values) > 1:
                    spread[key, classic].append(float(np.var(values, ddof=1)))
    print("| figure | spread | classic's | ratio | error | classic's | holds | classic's |")
    print("|---|---|---|---|---|---|---|---|")
    for key in dict.fromkeys(key for key, _ in errors):
        both = False, True
        own, classic_s = (float(np.sqrt(np.mean(spread[key, c]))) for c in both)
        rms = [float(np.sqrt(np.mean(np.square(errors[key, c])))) for c in both]
        hold = [float(np.mean(held[key, c])) for c in both]
        print(
            f"| {key} | {own:.3g} | {classic_s:.3g} | {own / classic_s:.2f} | {rms[0]:.3g} "
            f"| {rms[1]:.3g} | {hold[0]:.2f} | {hold[1]:.2f} |"
        )
    every = [
        np.mean([x for (_, c), row in held.items() if c == k for x in row]) for k in (False, True)
    ]
    print(f"intervals hold over all figures: {every[0]:.3f}, classic {every[1]:.3f}")


if __name__ == "__main__":
    main()
