"""Play and spool of an axis: those of the least residual, and what they leave unsure. Pure."""

import math
from dataclasses import replace
from typing import Final

import numpy as np

from valvemap.model.axis import SPOOL_DAMPING, AxisRegression, AxisSamples, AxisState
from valvemap.model.axis_fit import AxisFit, compared, with_theta
from valvemap.model.samples import Floats

_PLAYS: Final = (0.0, 1.0, 2.0, 3.0, 4.5, 6.0, 9.0, 13.0)  # %
_LAGS_S: Final = (0.0, 0.012, 0.025, 0.04, 0.06, 0.09, 0.13, 0.18)  # s; 1/f of the spool
_PLAY_STEPS: Final = (0.5, 0.125, 0.03)  # %
_LAG_STEPS_S: Final = (0.006, 0.003, 0.0015, 0.0008)  # s
_NEAR_STEPS: Final = ((0.5, 0.006), (0.125, 0.0015))  # %, s
_MOST_PLAY, _MOST_LAG_S = 20.0, 0.2
_LAG_PER_DELAY: Final = math.pi / SPOOL_DAMPING  # of slow courses


def with_spool(regression: AxisRegression, samples: AxisSamples) -> AxisRegression:
    """Return the regression with the play and spool of the least residual.

    Both delay the spool, so that the valley of the loss is oblique: each lag is judged with its own
    best play.
    """
    losses: dict[tuple[float, float], float] = {}

    def loss(at: tuple[float, float]) -> float:
        if at not in losses:
            losses[at] = _loss(_with(regression, at), samples)
        return losses[at]

    def with_best_play(lag_s: float, play: float) -> tuple[float, float]:
        best = play, lag_s
        for step in _PLAY_STEPS:
            while True:
                beside = [(min(max(best[0] + d, 0.0), _MOST_PLAY), lag_s) for d in (step, -step)]
                better = min(beside, key=loss)
                if loss(better) >= loss(best):
                    break
                best = better
        return best

    first = min(((play, _LAGS_S[1]) for play in _PLAYS), key=loss)
    best = min((with_best_play(lag_s, first[0]) for lag_s in _LAGS_S), key=loss)
    for step in _LAG_STEPS_S:
        while True:
            beside = [with_best_play(_bounded(best[1] + d), best[0]) for d in (step, -step)]
            better = min(beside, key=loss)
            if loss(better) >= loss(best):
                break
            best = better
    return _with(regression, best)


def with_spool_near(
    regression: AxisRegression, samples: AxisSamples, less_s: float = 0.0
) -> AxisRegression:
    """Return the regression with the play and spool of the least residual near its own.

    The descent begins at its lag, or at one whose delay is less by ``less_s``.
    """
    losses: dict[tuple[float, float], float] = {}

    def loss(at: tuple[float, float]) -> float:
        if at not in losses:
            losses[at] = _loss(_with(regression, at), samples)
        return losses[at]

    play, lag_s = regression.play_percent, 1.0 / regression.spool_hz
    moved = play, _bounded(lag_s - _LAG_PER_DELAY * less_s)
    best = min(((play, lag_s), moved), key=loss)
    for of_play, of_lag_s in _NEAR_STEPS:
        while True:
            play, lag_s = best
            beside = [(play, _bounded(lag_s + d)) for d in (of_lag_s, -of_lag_s)]
            beside += [(max(play + d, 0.0), lag_s) for d in (of_play, -of_play)]
            better = min(beside, key=loss)
            if loss(better) >= loss(best):
                break
            best = better
    return _with(regression, best)


def with_play_near(
    regression: AxisRegression, samples: AxisSamples, theta: Floats
) -> AxisRegression:  # fmt: skip
    """Return the regression with the play of the least residual, where signals may be delayed.

    Play delays the spool. Where U is shown late and the search knows no delay, it finds a play that
    is too narrow. The lag stays, because a delay of U has the same effect. ``theta`` (n,) are the
    coefficients of a fit.
    """
    losses: dict[float, float] = {}

    def loss(play: float) -> float:
        if play not in losses:
            tried = replace(regression, play_percent=play)
            state, _ = tried.update(with_theta(tried.initial_state(), theta), samples)
            losses[play] = compared(state)[1]
        return losses[play]

    best = regression.play_percent
    for step in _PLAY_STEPS:
        while True:
            better = min((min(max(best + d, 0.0), _MOST_PLAY) for d in (step, -step)), key=loss)
            if loss(better) >= loss(best):
                break
            best = better
    return replace(regression, play_percent=best)


def _loss(regression: AxisRegression, samples: AxisSamples) -> float:
    """Return the root mean square of the residuals of signals without delays, l/min."""
    return compared(regression.update(regression.initial_state(), samples)[0])[1]


def of_spool(found: AxisFit, state: AxisState, samples: AxisSamples) -> Floats:
    """Return the covariance (n, n) of the coefficients that is due to play and spool.

    The coefficients' slopes over play and lag come from fits beside the best; how well both are
    known, from the loss there and from the smallest step of the search.
    """
    regression, least = found.regression, np.array([_PLAY_STEPS[-1], _LAG_STEPS_S[-1]])
    play, lag_s = regression.play_percent, 1.0 / regression.spool_hz
    steps = 2.0 * least  # a step within the search's own would find nothing but its grain
    rows = 2.0 * state.squares[2] / found.together

    def tried(i: int, j: int) -> tuple[Floats, float]:
        at = play + i * steps[0], lag_s + j * steps[1]
        other = _with(regression, at)
        start = with_theta(other.initial_state(), state.theta)  # of whose columns the delays are
        return compared(other.update(start, samples)[0])

    here, ahead = compared(state), (tried(1, 0), tried(0, 1))
    slopes = np.stack(
        [(theta - here[0]) / step for (theta, _), step in zip(ahead, steps, strict=True)], axis=1
    )
    scale = rows / max(here[1] ** 2, 1e-12)
    rises = np.array([scale * (rms**2 - here[1] ** 2) for _, rms in ahead])
    known = steps**2 / np.maximum(rises, 1e-3)  # where the loss, in its units, has risen by 1
    spread = np.minimum(known, (4.0 * steps) ** 2) + least**2 / 3.0
    return np.asarray((slopes * spread) @ slopes.T)


def _bounded(lag_s: float) -> float:
    return min(max(lag_s, 0.0), _MOST_LAG_S)


def _with(regression: AxisRegression, at: tuple[float, float]) -> AxisRegression:
    play, lag_s = at
    return replace(regression, play_percent=play, spool_hz=1.0 / lag_s if lag_s > 0.0 else math.inf)
