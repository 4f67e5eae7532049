"""What a commissioning run has learnt: map, standard deviation over the range, route. Pure."""

import math
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from valvemap.model.estimator import Estimator
from valvemap.model.samples import Floats, Samples
from valvemap.pipeline.commission_answer import Expected
from valvemap.pipeline.commission_limits import Point, Range
from valvemap.pipeline.commission_plan import Uncertainty, route
from valvemap.pipeline.commission_state import Settings
from valvemap.vocabulary.statuses import Quality

POINTS_U, POINTS_S = 33, 13  # of the grid on which the map is judged
LEAST_DROP: Final = 2.0  # bar; smaller ones are not judged
NEXT_DROP: Final = (
    60.0  # bar; by which Δp may leave the samples' range until the map is learnt again
)
FLOOR: Final = 0.005  # of the largest flow; error of the meter that is always allowed
VISITS: Final = 3.0  # samples near a value of U that make a map there
OVER: Final = 4  # samples; over which flows and p1 are averaged
NEAR_MOST: Final = 0.97  # of the largest flow; above it p1 tells whether the supply is at its limit
DROPPED: Final = 0.93  # of the highest p1 at such flows: the supply gives no more


@dataclass(frozen=True)
class Supply:
    """The largest flow that was seen, l/min, and the range of p1 near it, bar."""

    most: float = 0.0
    p1: Range = (np.inf, -np.inf)

    @property
    def limit(self) -> float:
        """Largest flow that the supply gives, l/min; infinite while it was not at its limit."""
        return self.most if self.p1[0] < DROPPED * self.p1[1] else np.inf

    def after(self, samples: Samples) -> "Supply":
        """Return it after N samples; noise of the flow is averaged out over `OVER` of them."""
        Q = np.abs(_averaged(samples.Q))
        p1, most = _averaged(samples.p1), max(self.most, float(Q.max(initial=0.0)))
        before = self if self.most > NEAR_MOST * most else Supply()
        near = p1[NEAR_MOST * most < Q]
        low, high = float(near.min(initial=np.inf)), float(near.max(initial=-np.inf))
        return Supply(most, (min(before.p1[0], low), max(before.p1[1], high)))


@dataclass(frozen=True)
class Learnt:
    """Result after N samples: the estimator's state, and the judged map.

    ``drops`` is the range of Δp that was seen, bar; ``supply`` what the pump gave; ``T`` the newest
    temperature, °C; ``scatter2`` the mean square of the meter's noise, from successive samples,
    (l/min)²;
    ``visited`` the number of samples near each of `POINTS_U` values of U, (POINTS_U,).
    """

    state: Any
    samples: int = 0
    drops: Range = (np.inf, -np.inf)
    T: float = np.nan
    supply: Supply = field(default_factory=Supply)
    scatter2: float = 0.0
    visited: Floats = field(default_factory=lambda: np.zeros(POINTS_U))
    expected: Expected | None = None
    error: float = np.nan
    route: tuple[Point, ...] = ()
    number: int = 0


def learn(
    estimator: Estimator[Any], settings: Settings, before: Learnt, samples: Samples, at: Point
) -> Learnt:
    """Learn from N samples and plan the next moves from ``at``, the last command."""
    state, _ = estimator.update(before.state, samples)
    good = samples[samples.quality != Quality.BAD]
    if not len(good):
        return replace(before, state=state, samples=before.samples + len(samples))
    dp, T = good.dp, good.T[np.isfinite(good.T)]
    drops = min(before.drops[0], float(dp.min())), max(before.drops[1], float(dp.max()))
    learnt = Learnt(
        state,
        before.samples + len(samples),
        drops,
        float(T[-1]) if len(T) else before.T,
        before.supply.after(good),
        _averaged_in(before, before.scatter2, _scatter2(good.Q), len(good)),
        before.visited + _visits(settings.limits.U_range, good.U),
    )
    judged = uncertainty(estimator, settings.limits.U_range, learnt)
    pace = settings.plan.pace(settings.limits)
    newest = Point(float(good.U[-1]), float(dp[-1]))
    moves = route(settings.limits, pace, at, newest, judged) if at.is_known else ()
    learnt = replace(learnt, error=judged.rms, route=moves, number=before.number + 1)
    return replace(learnt, expected=expected(estimator, settings.limits.U_range, learnt))


def expected(estimator: Estimator[Any], U_range: Range, learnt: Learnt) -> Expected | None:
    """Return what the map predicts over the range of U and, until it is learnt again, of Δp."""
    low, high = learnt.drops
    if high <= LEAST_DROP or learnt.state is None:
        return None
    ends = max(low - NEXT_DROP, LEAST_DROP), high + NEXT_DROP
    s = np.linspace(math.sqrt(ends[0]), math.sqrt(ends[1]), POINTS_S)
    U = np.linspace(*U_range, POINTS_U)
    at = np.tile(U, POINTS_S), np.repeat(s**2, POINTS_U)
    Q, std = estimator.predict(learnt.state, *at, np.full(at[0].shape, learnt.T))
    Q, std = Q.reshape(POINTS_S, POINTS_U), std.reshape(POINTS_S, POINTS_U)
    meter = max(math.sqrt(learnt.scatter2), FLOOR * learnt.supply.most)
    known = learnt.visited >= VISITS  # beyond the samples, a map may be too sure
    return Expected(U, s, Q / s[:, None], std / s[:, None], known, learnt.number, meter)


def _visits(U_range: Range, U: Floats) -> Floats:
    place = (U - U_range[0]) / (U_range[1] - U_range[0]) * (POINTS_U - 1)
    near = np.clip(np.rint(place), 0, POINTS_U - 1).astype(np.int64)
    return np.bincount(near, minlength=POINTS_U).astype(np.float64)


def _scatter2(Q: Floats) -> float:
    """Mean square of Q about the line through its neighbours, by the median, (l/min)²."""
    if len(Q) < 3:
        return math.nan
    return (1.4826 * float(np.median(np.abs(np.diff(Q, 2))))) ** 2 / 6.0


def _averaged_in(before: Learnt, mean: float, new: float, samples: int) -> float:
    """Return the mean with that of a batch of so many samples; unchanged by one not known."""
    share = samples / (before.samples + samples)
    return mean + share * (new - mean) if math.isfinite(new) else mean


def uncertainty(estimator: Estimator[Any], U_range: Range, learnt: Learnt) -> Uncertainty:
    """Return the map's variance over the range of U and the seen range of Δp.

    What the supply cannot give is left out: no move would reach it.
    """
    low, high = learnt.drops
    if high <= LEAST_DROP or learnt.state is None:
        return Uncertainty(*(np.empty(0),) * 3)
    s = np.linspace(np.sqrt(max(low, LEAST_DROP)), np.sqrt(high), POINTS_S)
    U, drop = (x.ravel() for x in np.meshgrid(np.linspace(*U_range, POINTS_U), s**2))
    T = np.full(U.shape, learnt.T)
    Q, std = estimator.predict(learnt.state, U, drop, T)
    in_reach = ~(np.abs(Q) * NEAR_MOST > learnt.supply.limit)
    return Uncertainty(U[in_reach], drop[in_reach], std[in_reach] ** 2)


def _averaged(x: Floats) -> Floats:
    """Means over `OVER` successive values, (N // OVER,)."""
    whole = len(x) - len(x) % OVER
    return np.asarray(x[:whole].reshape(-1, OVER).mean(axis=1))
