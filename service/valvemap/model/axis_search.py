"""Identification of an axis from a recording: refusals in words, an answer otherwise."""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from valvemap.model.axis import AxisGeometry, AxisRegression, AxisSamples, AxisState
from valvemap.model.axis_fit import AxisFit, fit, with_theta
from valvemap.model.axis_misfit import misfit
from valvemap.model.axis_rest import Rest
from valvemap.model.axis_signal_check import MOST_FLOW, NAMELESS, PRESSURES, inconsistency
from valvemap.model.axis_spool import of_spool, with_play_near, with_spool
from valvemap.model.axis_travel import placed
from valvemap.model.samples import Floats
from valvemap.vocabulary.statuses import AxisStatus

_SLOWEST_S: Final = 0.0205  # s; 50 Hz: slower, the intervals no longer follow valve and pressures
_LEAST_S: Final = 60.0  # s of use; 30 s leave the maps at several standard deviations of a meter
_LEAST_SHARE: Final = 0.3  # of the intervals must be of use
_MISSING_SHARE: Final = 0.5
_STRAY: Final = 0.005  # of the positions at each end; spikes contradict no stroke
_BEYOND_STROKE: Final = 0.03  # of the stroke, by a sensor's zero
_LEAST_BEYOND_MM: Final = 5.0  # mm; the same of a short stroke
_LEAST_TRAVEL: Final = 0.002  # of the stroke; positions in m move by less
_MODULUS_GPa: Final = (0.1, 2.0)
_LEAST_SWING: Final = 10.0  # %; U must reach it in both directions
_SEARCHED: Final = 20_000  # samples; more do not move the minimum


@dataclass(frozen=True)
class AxisResult:
    """Result of :func:`identify`: a fit, or the reason why there is none.

    ``status`` other than OK: ``fit`` must not be used, and ``sentence`` says why and what to do.
    ``left_out`` has the number of intervals by reason, and of samples at rest. ``state`` continues
    the fit sample by sample; ``of_shape`` (n, n) is the part of its covariance that is due to play
    and spool, and to an inconsistent signal.
    """

    status: AxisStatus
    sentence: str
    fit: AxisFit | None
    left_out: dict[str, int]
    state: AxisState | None = None
    of_shape: Floats | None = None


def identify(
    samples: AxisSamples,
    geometry: AxisGeometry,
    *,
    searched: bool = True,
    memory_s: float = math.inf,
) -> AxisResult:
    """Identify an axis from a recording.

    Parameters
    ----------
    samples : AxisSamples
    geometry : AxisGeometry
    searched
        Whether play and spool are found by the residual; else neither is assumed.
    memory_s
        Time constant of forgetting, s of use.

    Examples
    --------
    >>> t = np.arange(100) * 10_000_000
    >>> still = AxisSamples.of(t, U=np.zeros(100), x=np.zeros(100))
    >>> identify(still, AxisGeometry(63, 45, 800, 1.2, 1.2)).status
    <AxisStatus.NO_PRESSURES: 1>
    """
    samples = placed(samples, geometry.stroke_mm)
    period_s, refused = _period(samples)
    if refused is not None:
        return refused
    regression = AxisRegression(geometry, period_s, has_place=not np.isfinite(samples.v).any())
    _, moves = Rest.initial().update(samples)
    resting, samples = int(np.sum(~moves)), samples[moves]
    left_out, refused = _unusable(regression, samples, resting)
    if refused is not None:
        return refused
    if searched:
        regression = with_spool(regression, samples[:_SEARCHED])
    regression = replace(regression, memory_s=memory_s)
    state, found = fitted(regression, samples)
    if searched:
        again = with_play_near(regression, samples[:_SEARCHED], found.theta)
        if again.play_percent != regression.play_percent:
            regression = again
            state, found = fitted(regression, samples)
    of_shape = of_spool(found, state, samples) if searched else np.zeros_like(found.covariance)
    wrong = (
        inconsistency(regression, samples[:_SEARCHED], found.together, found.theta)
        if searched
        else None
    )
    if wrong is not None:
        of_shape = of_shape + np.outer(wrong.change, wrong.change)
    left = misfit(regression, state, samples) if searched else 0.0
    found = replace(found, covariance=found.covariance + of_shape)
    status, details = AxisStatus.OK, []
    if wrong is not None and wrong.is_large:
        status, details = AxisStatus.SIGNAL_INCONSISTENT, [wrong.words]
    elif left > MOST_FLOW:
        status, details = AxisStatus.SIGNAL_INCONSISTENT, [NAMELESS]
    if not _MODULUS_GPa[0] <= found.bulk_modulus[0] <= _MODULUS_GPa[1]:
        status, details = AxisStatus.BULK_MODULUS, [f"{found.bulk_modulus[0]:.2f} GPa", *details]
    sentence = f"{status.sentence} ({'; '.join(details)})" if details else status.sentence
    return AxisResult(status, sentence, found, left_out, state, of_shape)


def fitted(regression: AxisRegression, samples: AxisSamples) -> tuple[AxisState, AxisFit]:
    """Return state and fit of samples.

    The first fit knows no delays, and no residuals for its intervals; the second has its columns of
    the delays, and the third the residuals that they leave.
    """
    state, _ = regression.update(regression.initial_state(), samples)
    for _ in range(2):
        start = with_theta(regression.initial_state(), fit(regression, state).theta)
        state, _ = regression.update(start, samples)
    return state, fit(regression, state)


def _unusable(
    regression: AxisRegression, samples: AxisSamples, resting: int
) -> tuple[dict[str, int], AxisResult | None]:
    """As `_too_little`, and the refusal of positions that contradict the stroke."""
    fault = _misplaced(samples.x, regression.geometry.stroke_mm) if regression.has_place else ""
    if not fault:
        return _too_little(regression, samples, resting)
    status = AxisStatus.SIGNAL_INCONSISTENT
    return {}, AxisResult(status, f"{status.sentence} ({fault})", None, {})


def _too_little(
    regression: AxisRegression, samples: AxisSamples, resting: int
) -> tuple[dict[str, int], AxisResult | None]:
    """Return the intervals by reason, and the refusal of samples too few of which can be used.

    Neither depends on play and spool, so that a search, which takes long, is not begun in vain.
    """
    state, _ = regression.update(regression.initial_state(), samples)
    left_out = {**state.reasons(), "at rest": resting}
    use_s, n = state.rows * regression.period_s, len(samples)

    def refused(status: AxisStatus, detail: str) -> tuple[dict[str, int], AxisResult]:
        sentence = f"{status.sentence} ({detail})"
        return left_out, AxisResult(status, sentence, None, left_out)

    if use_s < _LEAST_S:
        if left_out["end stop"] > _LEAST_SHARE * n:
            return refused(AxisStatus.END_STOPS, f"{left_out['end stop']} of {n} samples")
        if left_out["low pressure"] > _LEAST_SHARE * n:
            return refused(AxisStatus.LOW_PRESSURE, f"{left_out['low pressure']} samples")
        return refused(AxisStatus.TOO_SHORT, f"{use_s:.0f} s of use")
    low, high = float(np.nanmin(samples.U)), float(np.nanmax(samples.U))
    if min(high, -low) < _LEAST_SWING:
        return refused(AxisStatus.UNEXCITED, f"U from {low:.0f} to {high:.0f} %")
    still = [name for name in PRESSURES if _is_still(samples, name)]
    if still:
        return refused(AxisStatus.MISSING_PRESSURE, f"{', '.join(still)} never changes")
    return left_out, None


def _period(samples: AxisSamples) -> tuple[float, AxisResult | None]:
    """Return the sampling period (s), or the refusal of samples that cannot be used."""

    def refusal(status: AxisStatus, detail: str) -> tuple[float, AxisResult]:
        return math.nan, AxisResult(status, f"{status.sentence} ({detail})", None, {})

    if len(samples) < 2:
        return refusal(AxisStatus.TOO_SHORT, f"{len(samples)} samples")
    missing = [
        name for name in PRESSURES if np.mean(~np.isfinite(getattr(samples, name))) > _MISSING_SHARE
    ]
    if len(missing) == 4:
        return refusal(AxisStatus.NO_PRESSURES, "position and command alone")
    if missing:
        return refusal(AxisStatus.MISSING_PRESSURE, f"{', '.join(missing)} missing")
    for name in ("x", "U"):
        if np.mean(~np.isfinite(getattr(samples, name))) > _MISSING_SHARE:
            there = float(np.mean(np.isfinite(getattr(samples, name))))
            part = f"{name} in {100.0 * there:.0f} % of the samples" if there else f"{name} missing"
            return refusal(AxisStatus.MISSING_SIGNAL, part)
    period_s = 1e-9 * float(np.median(np.diff(samples.t)))
    if not 0.0 < period_s <= _SLOWEST_S:
        rate = f"{1.0 / period_s:.1f} Hz" if period_s > 0.0 else "no time between the samples"
        return refusal(AxisStatus.TOO_SLOW, rate)
    return period_s, None


def _misplaced(x: Floats, stroke_mm: float) -> str:
    """How positions (N,), mm, contradict the stroke; empty if they do not."""
    x = x[np.isfinite(x)]
    if not len(x):
        return ""
    low, high = (float(q) for q in np.quantile(x, [_STRAY, 1.0 - _STRAY]))
    slack = max(_BEYOND_STROKE * stroke_mm, _LEAST_BEYOND_MM)
    if low < -slack or high > stroke_mm + slack:
        return f"x is {low:.4g} … {high:.4g} mm, the stroke 0 … {stroke_mm:g} mm"
    if 0.0 < high - low < _LEAST_TRAVEL * stroke_mm:
        return f"x is {low:.3g} … {high:.3g} mm, of a stroke of {stroke_mm:g} mm: is it in mm?"
    return ""


def _is_still(samples: AxisSamples, name: str) -> bool:
    """Whether a signal shows one number all the time, which no transmitter does."""
    shown = getattr(samples, name)
    return bool(np.nanmin(shown) == np.nanmax(shown))
