"""What the maps say of themselves where nothing was measured: cells of `benchmarks.honest_maps`.

Each estimator learns 5,000 scattered samples from a part of the range, through the pipeline, and
is asked everywhere in 0-100 %, 0-200 bar. *Inside* is within 5 % of U and 5 bar of three samples at
least. By valve and estimator, pooled over parts of the range and seeds:

- honest: share of the points outside that the 95 % interval covers, or that are EXTRAPOLATING
- inside called so: share of the points inside that are EXTRAPOLATING
- followed: where exact least squares are sure to 2 % of the largest flow, share of the points
  outside that are not EXTRAPOLATING
- width: of the interval there, over that of exact least squares (eq. (7) alone)
- inverse honest: the same of the inverse, share of demands whose U lies outside that are honest
"""

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmarks import circumstances as c
from benchmarks.cells import Cell, Figures, Judged
from benchmarks.measured_data import Floats
from valvemap.app.build import build_plans
from valvemap.config.models import Config
from valvemap.model.inverse_map import invert
from valvemap.model.model_structures import FiveTerms
from valvemap.model.residual_spread import TWO_SIDED_95
from valvemap.model.samples import Samples, Segments
from valvemap.pipeline.fleet import Fleet
from valvemap.pipeline.lane_predictions import predicted
from valvemap.pipeline.valve_state import Lane
from valvemap.vocabulary.statuses import InverseStatus, Status

Part = tuple[tuple[float, float], tuple[float, float]]

SIGMA, N, POINTS, T = 0.4, 5_000, 3_000, 40.0
Q_MAX, SURE = 200.0, 0.02
HONEST, CALLED, WIDEST = 0.99, 0.01, 2.0  # share outside, share inside, times exact least squares
PARTS: Final[tuple[Part, ...]] = (
    ((5, 40), (5, 60)),
    ((50, 95), (100, 190)),
    ((20, 60), (20, 120)),
    ((0, 100), (2, 50)),
    ((30, 70), (2, 198)),
)


VALVES: Final = {
    name: c.VALVES[name]
    for name in ("ordinary", "dead band", "S-shape", "eq. (7)", "saturating", "laminar")
}


@dataclass(frozen=True)
class Counts:
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

    def __add__(self, other: "Counts") -> "Counts":
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Counts(*(a + b for a, b in pairs))


def learnt(
    valve: c.Valve, part: Part, seed: int, n: int = N, at: float = T
) -> tuple[Fleet, Samples]:
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


def figures(
    lane: Lane, samples: Samples, valve: c.Valve, seed: int, points: int = POINTS
) -> Counts:
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
    return Counts(
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


def one(name: str, seed: int) -> Figures:
    """Counts of each estimator on a valve, over all parts of the range."""
    total: dict[str, Counts] = {}
    for part in PARTS:
        fleet, samples = learnt(VALVES[name], part, seed)
        for lane in fleet.plan.estimators:
            found = figures(fleet.lane(0, lane), samples, VALVES[name], seed)
            total[lane] = total[lane] + found if lane in total else found
    return {lane: vars(found) for lane, found in total.items()}


def judge(name: str, lane: str, found: Sequence[Figures]) -> Judged:
    """Shares over seeds, parts and points."""
    f = reduce(operator.add, (Counts(**figures[lane]) for figures in found))
    honest, called = f.honest / f.outside, f.inside_called / f.inside
    inverse = f.answered_honestly / f.demands
    figure = f"honest {honest:.4f}, inside called so {called:.4f}, inverse honest {inverse:.4f}"
    met = honest >= HONEST and called <= CALLED and inverse >= HONEST
    if name == "eq. (7)" and lane != "RBF":
        followed, width = f.followed / f.sure, f.widths / f.sure
        figure += f", followed {followed:.3f}, width {width:.2f} × least squares"
        met = met and followed >= HONEST and width <= WIDEST
    return Judged(figure, "≥ .99, ≤ .01, ≥ .99; eq. (7): ≤ 2 ×", met)


def cells() -> Mapping[str, Cell]:
    """A cell per valve and estimator; those of one valve share their measurements."""
    return {
        f"outside, {lane} on {name}": Cell(10, partial(one, name), partial(judge, name, lane), name)
        for name in VALVES
        for lane in ("RLS", "RML", "RBF", "Auto")
    }
