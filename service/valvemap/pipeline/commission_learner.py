"""What a commissioning run has learnt: map, standard deviation over the range, route. Pure."""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from valvemap.model.estimator import Estimator
from valvemap.model.samples import Samples
from valvemap.pipeline.commission_limits import Point, Range
from valvemap.pipeline.commission_plan import Uncertainty, route
from valvemap.pipeline.commission_state import Settings
from valvemap.vocabulary.statuses import Quality

POINTS_U, POINTS_S = 33, 13  # of the grid on which the map is judged
LEAST_DROP: Final = 2.0  # bar; smaller ones are not judged


@dataclass(frozen=True)
class Learnt:
    """Result after N samples: the estimator's state, and the judged map.

    ``drops`` is the range of Δp that was seen, bar; ``T`` the newest temperature, °C.
    """

    state: Any
    samples: int = 0
    drops: Range = (np.inf, -np.inf)
    T: float = np.nan
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
        state, before.samples + len(samples), drops, float(T[-1]) if len(T) else before.T
    )
    judged = uncertainty(estimator, settings.limits.U_range, learnt)
    pace = settings.plan.pace(settings.limits)
    newest = Point(float(good.U[-1]), float(dp[-1]))
    moves = route(settings.limits, pace, at, newest, judged) if at.is_known else ()
    return replace(learnt, error=judged.rms, route=moves, number=before.number + 1)


def uncertainty(estimator: Estimator[Any], U_range: Range, learnt: Learnt) -> Uncertainty:
    """Return the map's variance over the range of U and the seen range of Δp."""
    low, high = learnt.drops
    if high <= LEAST_DROP or learnt.state is None:
        return Uncertainty(*(np.empty(0),) * 4)
    s = np.linspace(np.sqrt(max(low, LEAST_DROP)), np.sqrt(high), POINTS_S)
    U, drop = (x.ravel() for x in np.meshgrid(np.linspace(*U_range, POINTS_U), s**2))
    T = np.full(U.shape, learnt.T)
    Q, std = estimator.predict(learnt.state, U, drop, T)
    return Uncertainty(U, drop, std**2, Q)
