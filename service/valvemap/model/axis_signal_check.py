"""Whether one signal of an axis does not fit the others: what a better one would leave. Pure.

Each signal is tried a little later or earlier, with another zero, or smoothed. Where the samples
are much likelier so, the signal is inconsistent: the coefficients' difference is part of their
uncertainty, and if it is large the answer must not be used.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from valvemap.model.axis import AxisRegression, AxisSamples
from valvemap.model.axis_basis import COMMON, columns, edge_regressors
from valvemap.model.axis_fit import compared
from valvemap.model.kernels import axis_rows as kernel
from valvemap.model.samples import Floats
from valvemap.vocabulary.edges import EDGES

LATE_S: Final = 0.02  # s; step of a delay
ZERO_BAR: Final = 2.0  # bar; step of a zero
SMOOTHED: Final = 5  # samples whose mean stands for one
MOST: Final = 8  # steps
SIGNIFICANT: Final = 30.0  # twice the log likelihood ratio that makes a signal inconsistent
MOST_COMPLIANCE, MOST_FLOW = 0.1, 0.02  # shares of 1/β and flow, by which an answer may be off
PRESSURES: Final = ("pA", "pB", "pS", "pT")

_Variant = Callable[[AxisSamples, int], AxisSamples]  # with the number of steps


@dataclass(frozen=True)
class Inconsistency:
    """What would fit better, in words; the coefficients' difference (n,), and whether it is large.

    ``gain`` is twice the log likelihood ratio.
    """

    words: str
    change: Floats
    gain: float
    is_large: bool


def inconsistency(
    regression: AxisRegression, samples: AxisSamples, together: float
) -> Inconsistency | None:
    """Return the likeliest inconsistency, or None: no signal would fit better.

    ``together`` is the number of rows that count as one.
    """

    def fitted(tried: AxisSamples) -> tuple[Floats, float, float]:
        state, _ = regression.update(regression.initial_state(), tried)
        return (*compared(state), 2.0 * float(state.squares[2]) / together)

    theta, rms, rows = fitted(samples)
    best: tuple[float, str, Floats] | None = None
    for words, step, variant, most in _variants(regression.period_s):
        least, last, changed = rms, 0.0, theta
        for k in range(1, most + 1):
            other, left, _ = fitted(variant(samples, k))
            if not left < least:
                break
            least, last, changed = left, float(k), other
        gain = 2.0 * rows * math.log(rms / max(least, 1e-9)) if last else 0.0
        if gain > max(SIGNIFICANT, best[0] if best else 0.0):
            best = gain, words.format(last * step), changed - theta
    if best is None:
        return None
    return Inconsistency(best[1], best[2], best[0], _is_large(theta, best[2]))


def _variants(period_s: float) -> Iterator[tuple[str, float, _Variant, int]]:
    """Yield variants: words with a place for the size, size of a step, function, most steps."""
    n = max(round(LATE_S / period_s), 1)
    late_ms = 1e3 * n * period_s
    for names, what in ((("x", "v"), "position or speed"), (PRESSURES, "the pressures")):
        for sign, how in ((-1, "late"), (1, "early")):
            yield f"{what} {{:.0f}} ms too {how}", late_ms, _moved(names, sign * n), MOST
    for name in PRESSURES:
        for by, how in ((-ZERO_BAR, "high"), (ZERO_BAR, "low")):
            yield f"{name} {{:.0f}} bar too {how}", ZERO_BAR, _raised(name, by), MOST
        yield f"{name} noisy", 0.0, _smoothed(name), 1


def _moved(names: tuple[str, ...], by: int) -> _Variant:
    def variant(samples: AxisSamples, k: int) -> AxisSamples:
        at = np.clip(np.arange(len(samples)) - k * by, 0, len(samples) - 1)
        return replace(samples, **{name: getattr(samples, name)[at] for name in names})

    return variant


def _raised(name: str, by: float) -> _Variant:
    return lambda samples, k: replace(samples, **{name: getattr(samples, name) + k * by})


def _smoothed(name: str) -> _Variant:
    def variant(samples: AxisSamples, _: int) -> AxisSamples:
        half = SMOOTHED // 2
        beside = np.pad(getattr(samples, name), half, mode="edge")
        mean = np.convolve(beside, np.full(SMOOTHED, 1.0 / SMOOTHED), "valid")
        return replace(samples, **{name: mean})

    return variant


def _is_large(theta: Floats, change: Floats) -> bool:
    U, dp = (x.ravel() for x in np.meshgrid(np.linspace(10.0, 100.0, 10), (10.0, 40.0, 100.0)))
    X = edge_regressors(U, dp)
    flow, other = (np.concatenate([X @ x[columns(e)] for e in EDGES]) for x in (theta, change))
    compliance = COMMON + kernel.COMPLIANCE
    return bool(
        abs(change[compliance]) > MOST_COMPLIANCE * abs(theta[compliance])
        or float(np.linalg.norm(other)) > MOST_FLOW * float(np.linalg.norm(flow))
    )
