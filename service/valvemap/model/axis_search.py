"""Identification of an axis from a recording: refusals in words, play and spool by the residual."""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from valvemap.model.axis import (
    AxisFit,
    AxisGeometry,
    AxisRegression,
    AxisSamples,
    AxisState,
    fit,
    misfit,
    with_theta,
)
from valvemap.vocabulary.statuses import AxisStatus

_SLOWEST_S: Final = 0.0205  # s; 50 Hz: slower, the intervals no longer follow valve and pressures
_LEAST_S: Final = 60.0  # s of use; 30 s leave the maps at several standard deviations of a meter
_LEAST_SHARE: Final = 0.3  # of the intervals must be of use
_MISSING_SHARE: Final = 0.5
_MODULUS_GPa: Final = (0.1, 2.0)
_LEAST_SWING: Final = 10.0  # %; U must reach it in both directions
_PLAYS: Final = (0.0, 1.0, 3.0)  # %
_LAGS_S: Final = (0.0, 0.025, 0.06)  # s; 1/f of the spool
_STEPS: Final = (1.0, 0.012)  # %, s; first steps of the pattern search
_HALVINGS: Final = 5
_MOST_PLAY, _MOST_LAG_S = 10.0, 0.2
_SEARCHED: Final = 20_000  # samples; more do not move the minimum


@dataclass(frozen=True)
class AxisResult:
    """Result of :func:`identify`: a fit, or the reason why there is none.

    ``status`` other than OK: ``fit`` must not be used, and ``sentence`` says why and what to do.
    ``left_out`` has the number of intervals by reason.
    """

    status: AxisStatus
    sentence: str
    fit: AxisFit | None
    left_out: dict[str, int]


def identify(samples: AxisSamples, geometry: AxisGeometry, *, searched: bool = True) -> AxisResult:
    """Identify an axis from a recording.

    Parameters
    ----------
    samples : AxisSamples
    geometry : AxisGeometry
    searched
        Whether play and spool are found by the residual; else neither is assumed.

    Examples
    --------
    >>> t = np.arange(100) * 10_000_000
    >>> still = AxisSamples.of(t, U=np.zeros(100), x=np.zeros(100))
    >>> identify(still, AxisGeometry(63, 45, 800, 1.2, 1.2)).status
    <AxisStatus.NO_PRESSURES: 1>
    """
    period_s, refused = _period(samples)
    if refused is not None:
        return refused
    regression = AxisRegression(geometry, period_s)
    if searched:
        regression = _searched(regression, samples[:_SEARCHED])
    state, found = fitted(regression, samples)
    left_out = state.reasons()
    use_s = state.rows * period_s
    status, detail = AxisStatus.OK, ""
    if left_out["end stop"] > _LEAST_SHARE * len(samples) and use_s < _LEAST_S:
        status, detail = AxisStatus.END_STOPS, f"{left_out['end stop']} of {len(samples)} samples"
    elif left_out["low pressure"] > _LEAST_SHARE * len(samples) and use_s < _LEAST_S:
        status, detail = AxisStatus.LOW_PRESSURE, f"{left_out['low pressure']} samples"
    elif use_s < _LEAST_S:
        status, detail = AxisStatus.TOO_SHORT, f"{use_s:.0f} s of use"
    elif min(np.nanmax(samples.U), -np.nanmin(samples.U)) < _LEAST_SWING:
        status = AxisStatus.UNEXCITED
        detail = f"U from {np.nanmin(samples.U):.0f} to {np.nanmax(samples.U):.0f} %"
    elif not _MODULUS_GPa[0] <= found.bulk_modulus[0] <= _MODULUS_GPa[1]:
        status, detail = AxisStatus.BULK_MODULUS, f"{found.bulk_modulus[0]:.2f} GPa"
    sentence = f"{status.sentence} ({detail})" if detail else status.sentence
    return AxisResult(status, sentence, found, left_out)


def fitted(regression: AxisRegression, samples: AxisSamples) -> tuple[AxisState, AxisFit]:
    """Return state and fit of samples, with the residuals of a first fit for its intervals."""
    first, _ = regression.update(regression.initial_state(), samples)
    start = with_theta(regression.initial_state(), fit(regression, first).theta)
    state, _ = regression.update(start, samples)
    return state, fit(regression, state)


def _period(samples: AxisSamples) -> tuple[float, AxisResult | None]:
    """Return the sampling period (s), or the refusal of samples that cannot be used."""

    def refusal(status: AxisStatus, detail: str) -> tuple[float, AxisResult]:
        return math.nan, AxisResult(status, f"{status.sentence} ({detail})", None, {})

    if len(samples) < 2:
        return refusal(AxisStatus.TOO_SHORT, f"{len(samples)} samples")
    missing = [
        name
        for name in ("pA", "pB", "pS", "pT")
        if np.mean(~np.isfinite(getattr(samples, name))) > _MISSING_SHARE
    ]
    if len(missing) == 4:
        return refusal(AxisStatus.NO_PRESSURES, "position and command alone")
    if missing:
        return refusal(AxisStatus.MISSING_PRESSURE, f"{', '.join(missing)} missing")
    for name in ("x", "U"):
        if np.mean(~np.isfinite(getattr(samples, name))) > _MISSING_SHARE:
            return refusal(AxisStatus.MISSING_SIGNAL, f"{name} missing")
    period_s = 1e-9 * float(np.median(np.diff(samples.t)))
    if not 0.0 < period_s <= _SLOWEST_S:
        rate = f"{1.0 / period_s:.1f} Hz" if period_s > 0.0 else "no time between the samples"
        return refusal(AxisStatus.TOO_SLOW, rate)
    return period_s, None


def _searched(regression: AxisRegression, samples: AxisSamples) -> AxisRegression:
    """Return the regression with the play and spool of the least residual (pattern search)."""
    losses: dict[tuple[float, float], float] = {}

    def loss(at: tuple[float, float]) -> float:
        if at not in losses:
            tried = _with(regression, at)
            state, _ = tried.update(tried.initial_state(), samples)
            losses[at] = misfit(state)
        return losses[at]

    best = min(((play, lag) for play in _PLAYS for lag in _LAGS_S), key=loss)
    steps = np.array(_STEPS)
    for _ in range(_HALVINGS):
        while True:
            around = [
                (
                    min(max(best[0] + i * steps[0], 0.0), _MOST_PLAY),
                    min(max(best[1] + j * steps[1], 0.0), _MOST_LAG_S),
                )
                for i, j in ((1, 0), (-1, 0), (0, 1), (0, -1))
            ]
            better = min(around, key=loss)
            if loss(better) >= loss(best):
                break
            best = better
        steps = steps / 2.0
    return _with(regression, best)


def _with(regression: AxisRegression, at: tuple[float, float]) -> AxisRegression:
    play, lag_s = at
    return replace(regression, play_percent=play, spool_hz=1.0 / lag_s if lag_s > 0.0 else math.inf)
