"""What the maps say of themselves where nothing was measured: ``python -m benchmarks.outside``.

Each estimator learns 5,000 scattered samples from a part of the range, through the pipeline, and
is asked everywhere in 0-100 %, 0-200 bar. *Inside* is within 5 % of U and 5 bar of three samples at
least. ``python -m benchmarks.outside [SEEDS]`` prints by valve and estimator, pooled over parts of
the range and seeds:

- honest: share of the points outside that the 95 % interval covers, or that are EXTRAPOLATING
- covered: share of them that the interval covers
- inside called so: share of the points inside that are EXTRAPOLATING
- followed: where exact least squares are sure to 2 % of the largest flow, share of the points
  outside that are not EXTRAPOLATING
- width: of the interval there, over that of exact least squares (eq. (7) alone)

and by estimator the same of the inverse: share of demands whose U lies outside that are honest.
"""

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.measured_data import Floats
from service.app.build import build_plans
from service.config.models import Config
from service.identification.inverse_map import invert
from service.identification.inversion import InverseStatus
from service.identification.model_structures import FiveTerms
from service.identification.residual_spread import TWO_SIDED_95
from service.identification.samples import Samples, Segments, Status
from service.streaming.fleet import Fleet
from service.streaming.pipeline import Lane, predicted

Valve = Callable[[Floats, Floats], Floats]
Part = tuple[tuple[float, float], tuple[float, float]]

SIGMA, N, POINTS, T = 0.4, 5_000, 3_000, 40.0
Q_MAX, SURE = 200.0, 0.02
PARTS: Final[tuple[Part, ...]] = (
    ((5, 40), (5, 60)),
    ((50, 95), (100, 190)),
    ((20, 60), (20, 120)),
    ((0, 100), (2, 50)),
    ((30, 70), (2, 198)),
)


def ordinary(U: Floats, dp: Floats) -> Floats:
    """A dead band of 4 %, a slightly bent gain."""
    u = np.clip((U - 4) / 96, 0, 1)
    return 14 * u * (1.15 - 0.15 * u) * np.sqrt(dp)


def dead_band(U: Floats, dp: Floats) -> Floats:
    """A dead band of 8 %."""
    u = np.clip((U - 8) / 92, 0, None)
    return 14 * u * (1 - 0.1 * u**2) * np.sqrt(dp)


def s_shape(U: Floats, dp: Floats) -> Floats:
    """An S-shaped gain."""
    u = U / 100
    return 14 * (3 * u**2 - 2 * u**3) * np.sqrt(dp) * (1 - 4e-4 * dp)


def eq_7(U: Floats, dp: Floats) -> Floats:
    """Exactly eq. (7)."""
    return 1.0 + 0.02 * U + 0.3 * np.sqrt(dp) + 0.12 * U * np.sqrt(dp) - 0.01 * dp


def saturating(U: Floats, dp: Floats) -> Floats:
    """A gain that bends all the way."""
    return 9 * np.tanh(U / 45) * np.sqrt(dp)


def laminar(U: Floats, dp: Floats) -> Floats:
    """Laminar at small dp, turbulent above."""
    return 14 * (U / 100) ** 1.3 * (np.sqrt(dp + 2.25) - 1.5)


VALVES: Final[Mapping[str, Valve]] = {
    "ordinary": ordinary,
    "dead band": dead_band,
    "S-shape": s_shape,
    "eq. (7)": eq_7,
    "saturating": saturating,
    "laminar": laminar,
}


@dataclass(frozen=True)
class Figures:
    """Counts over points; add them up."""

    inside: int
    inside_called: int
    outside: int
    honest: int
    covered: int
    sure: int
    followed: int
    widths: float
    demands: int
    answered_honestly: int

    def __add__(self, other: "Figures") -> "Figures":
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Figures(*(a + b for a, b in pairs))


def learnt(valve: Valve, part: Part, seed: int, n: int = N, at: float = T) -> tuple[Fleet, Samples]:
    """Scattered samples of a part of the range, and the default estimators that learnt them."""
    rng = np.random.default_rng(seed)
    U, dp = rng.uniform(*part[0], n), rng.uniform(*part[1], n)
    Q = valve(U, dp) + SIGMA * rng.standard_normal(n)
    samples = Samples.of(np.arange(n) * 10**7, U, dp + 5.0, 0.0 * dp + 5.0, Q, np.full(n, at))
    (plan,) = build_plans(Config())
    fleet = Fleet(plan, 1)
    for start in range(0, n, 500):
        batch = samples[start : start + 500]
        fleet.take(batch, Segments.one(len(batch)))
    return fleet, samples


def near(samples: Samples, U: Floats, dp: Floats) -> NDArray[np.bool_]:
    """Which points are inside (N,)."""
    close = [
        ((np.abs(samples.U - u) <= 5.0) & (np.abs(samples.dp - p) <= 5.0)).sum()
        for u, p in zip(U, dp, strict=True)
    ]
    return np.array(close) >= 3


def figures(lane: Lane, samples: Samples, valve: Valve, seed: int, points: int = POINTS) -> Figures:
    """Ask a map everywhere."""
    rng = np.random.default_rng(seed + 1000)
    U, dp = rng.uniform(0, 100, points), rng.uniform(0, 200, points)
    at = np.full(points, T)
    inside = near(samples, U, dp)
    Q, std, status = predicted(lane, U, dp, at)
    called = status == Status.EXTRAPOLATING
    covered = np.abs(Q - valve(U, dp)) <= TWO_SIDED_95 * std
    exact = least_squares_std(samples, U, dp)
    sure = ~inside & (TWO_SIDED_95 * exact <= SURE * Q_MAX)
    answer = invert(lane.estimator, lane.state, valve(U, dp), dp, at, support=lane.support)
    guessed = answer.status == InverseStatus.EXTRAPOLATING
    close = (answer.lower - 1e-9 <= U) & (answer.upper + 1e-9 >= U)
    given = ~inside & (answer.status != InverseStatus.NOT_MONOTONE)
    return Figures(
        inside=int(inside.sum()),
        inside_called=int((inside & called).sum()),
        outside=int((~inside).sum()),
        honest=int((~inside & (covered | called)).sum()),
        covered=int((~inside & covered).sum()),
        sure=int(sure.sum()),
        followed=int((sure & ~called).sum()),
        widths=float((std / exact)[sure].sum()),
        demands=int(given.sum()),
        answered_honestly=int((given & (close | guessed)).sum()),
    )


def least_squares_std(samples: Samples, U: Floats, dp: Floats) -> Floats:
    """Standard deviation of exact least squares on eq. (7), noise known (N,)."""
    X = FiveTerms().regressors(samples.U, samples.dp, samples.T)
    x = FiveTerms().regressors(U, dp, U)
    return np.asarray(SIGMA * np.linalg.norm(np.linalg.solve(np.linalg.qr(X)[1].T, x.T), axis=0))


def main() -> None:
    """Print a line per valve and estimator."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 2
    heads = ("honest", "covered", "inside called so", "followed", "width", "inverse honest")
    print(f"{'':12}{'':6}" + "".join(f"{head:>18}" for head in heads))
    for name, valve in VALVES.items():
        total: dict[str, Figures] = {}
        for part in PARTS:
            for seed in range(seeds):
                fleet, samples = learnt(valve, part, seed)
                for lane in fleet.plan.estimators:
                    found = figures(fleet.lane(0, lane), samples, valve, seed)
                    total[lane] = total[lane] + found if lane in total else found
        for lane, f in total.items():
            row = (
                f.honest / f.outside,
                f.covered / f.outside,
                f.inside_called / f.inside,
                f.followed / f.sure,
                f.widths / f.sure,
                f.answered_honestly / f.demands,
            )
            print(f"{name:12}{lane:6}" + "".join(f"{x:18.4f}" for x in row), flush=True)


if __name__ == "__main__":
    main()
