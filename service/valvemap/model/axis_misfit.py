"""By how much an axis is not as its equations: what noise of the piston does not explain. Pure.

The position's noise σ comes from its third differences, which movement hardly has::

    σ = 1.4826·median|Δ³x|/√20                 Δ³ of white noise: (1 + 9 + 9 + 1)·σ²
    noise of a row = 6e-3·A·σ·√Σh²             h: the filter's response to one sample's noise
    misfit = √(e² - noise²)/y                  e, y: root mean squares of residual and A·ẋ

White noise of a measured speed likewise. The pressures' noise is part of the misfit: it is in the
regressors, and so in the edges.
"""

import math
from typing import Final

import numpy as np

from valvemap.model.axis import AxisRegression, AxisSamples, AxisState
from valvemap.model.samples import Floats

_OF_THIRD: Final = math.sqrt(20.0)  # standard deviation of Δ³ of white noise of 1
_OF_MEDIAN: Final = 1.4826  # standard deviation over the median of the sizes, of a Gaussian
_LASTS: Final = 20.0  # times the filter's; its response has then ended


def misfit(regression: AxisRegression, state: AxisState, samples: AxisSamples) -> float:
    """Return the misfit of the worse line, a share of its flow.

    Parameters
    ----------
    regression : AxisRegression
    state
        After the samples, with the coefficients of their fit (`AxisState.errors`).
    samples : AxisSamples
    """
    g, rows = regression.geometry, max(float(state.squares[2]), 1.0)
    noise = 6e-3 * np.array([g.A_A, g.A_B]) * _noise_of_speed(regression, samples)
    left = np.maximum(state.errors[:, 0] / rows - noise**2, 0.0)
    return float(np.sqrt(np.max(left / np.maximum(state.squares[:2] / rows, 1e-12))))


def _noise_of_speed(regression: AxisRegression, samples: AxisSamples) -> float:
    """Return the standard deviation of the filtered speed's noise, mm/s."""
    period_s = regression.period_s
    share = -math.expm1(-2.0 * math.pi * regression.filter_hz * period_s)
    k = np.arange(math.ceil(_LASTS / share))
    h = np.pad(share**2 * (k + 1.0) * (1.0 - share) ** k, 1)
    if regression.has_place:
        return _noise(samples.x) * float(np.linalg.norm(np.diff(h))) / period_s
    return _noise(samples.v) * float(np.linalg.norm(h[1:] + h[:-1])) / 2.0


def _noise(shown: Floats) -> float:
    """Return the standard deviation of a signal's white noise; 0 if it has none.

    It is that of the samples between which the signal changes: a coarse one stands still at rest.

    >>> rng, t = np.random.default_rng(1), np.arange(10_000.0)
    >>> round(_noise(100.0 * np.sin(0.01 * t) + 0.5 * rng.standard_normal(10_000)), 2)
    0.5
    """
    third = np.abs(np.diff(shown, 3))
    third = third[np.isfinite(third) & (shown[3:] != shown[:-3])]
    return _OF_MEDIAN * float(np.median(third)) / _OF_THIRD if len(third) else 0.0
