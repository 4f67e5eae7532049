"""Whether one signal of an axis does not fit the others: what a better one would leave. Pure.

Each pressure is tried with another zero, or smoothed, U with a limited speed of the spool. Delays
up to 20 ms are coefficients of the fit; it finds longer ones shorter than they are. Where it finds
any, signals are tried later or earlier. A late position looks like a slow spool, and a late U like
a quick one: with each delay of theirs, the spool is searched again. Where the samples are much
likelier so, the signal is inconsistent: the coefficients' difference is part of their uncertainty,
and if it is large the answer must not be used. If samples stay inconsistent with three signals
mended, the axis is not as assumed, and no signal is named.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np

from valvemap.model.axis import AxisRegression, AxisSamples, AxisState, AxisTrace
from valvemap.model.axis_basis import COMMON, columns, edge_regressors
from valvemap.model.axis_fit import compared, with_theta
from valvemap.model.axis_spool import with_spool_near
from valvemap.model.kernels import axis_rows as kernel
from valvemap.model.kernels.axis_spool import limited
from valvemap.model.samples import Flags, Floats
from valvemap.vocabulary.edges import EDGES

LATE_S: Final = 0.02  # s; step of a delay; up to this one, the fit learns it
MOST_LATE_S: Final = 0.16  # s
LATE_SEEN: Final = 1.0  # 10 ms; delay learnt from which on longer ones are tried
ZERO_BAR: Final = 2.0  # bar; step of a zero
SMOOTHED: Final = 5  # samples whose mean stands for one
MOST: Final = 8  # steps of a zero
SLEWS: Final = tuple(float(round(2000.0 * 0.8**k, -1)) for k in range(16))  # %/s; of a spool
SIGNIFICANT: Final = 30.0  # twice the log likelihood ratio that makes a signal inconsistent
MOST_WRONG: Final = 3  # signals that are named at once
UNEXPLAINED: Final = 0.1  # of the first gain; what others would add to it where they explain it not
NAMELESS: Final = "several signals, or something in a line, as another valve: no name explains it"
MOST_COMPLIANCE, MOST_FLOW = 0.1, 0.02  # shares of 1/β and flow, by which an answer may be off
PRESSURES: Final = ("pA", "pB", "pS", "pT")
_DELAYS: Final = [COMMON + kernel.PISTON, COMMON + kernel.COMMAND]


class _Assumed(NamedTuple):
    """Samples, a regression with their play and spool, and coefficients that may have delays."""

    regression: AxisRegression
    samples: AxisSamples
    theta: Floats

    def showing(self, **signals: Floats) -> "_Assumed":
        """Return these with other values of signals."""
        changed: dict[str, Any] = dict(signals)
        return self._replace(samples=replace(self.samples, **changed))

    def with_spool(self, less_s: float = 0.0) -> "_Assumed":
        """Return these with a better play and spool near theirs, if there is one.

        The search begins also at a delay that is less by ``less_s``; it knows no delays of signals.
        """
        found = with_spool_near(self.regression, self.samples, less_s)
        both = self, self._replace(regression=found)
        return min(both, key=lambda one: compared(one.summed()[0])[1])

    def summed(self, left_out: Flags | None = None) -> tuple[AxisState, AxisTrace]:
        """Return the sums of the samples, with columns for the delays of signals, and the trace."""
        start = with_theta(self.regression.initial_state(), self.theta)
        return self.regression.update(start, self.samples, left_out)


_Variant = Callable[[_Assumed, float], _Assumed]  # by a size


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
    regression: AxisRegression, samples: AxisSamples, together: float, theta: Floats
) -> Inconsistency | None:
    """Return the likeliest inconsistency, or None: no signal would fit better.

    Signals are mended one after the other until nothing else would fit better: these are named. If
    that does not end, or one comes again, none is.

    ``together`` is the number of rows that count as one, ``theta`` (n,) are coefficients: of what
    their delays explain, nothing is inconsistent.
    """
    found = _likeliest(_Assumed(regression, samples, theta), together)
    if found is None:
        return None
    wrong, rest = [found], _likeliest(found.mended, together)
    while rest and len(wrong) < MOST_WRONG and all(rest.kind != one.kind for one in wrong):
        wrong.append(rest)
        rest = _likeliest(rest.mended, together)
    is_small = rest is None or rest.gain < UNEXPLAINED * found.gain
    is_more = rest is not None and rest.kind == wrong[-1].kind  # of the same
    words = ", ".join(one.words for one in wrong) if is_small or is_more else NAMELESS
    change = np.sum([one.change for one in wrong], axis=0)
    return Inconsistency(words, change, found.gain, _is_large(found.theta, change))


@dataclass(frozen=True)
class _Likeliest:
    """The variant that fits best: coefficients without it, and what it changes, (n,) each.

    ``kind`` are its words without the size.
    """

    kind: str
    words: str
    theta: Floats
    change: Floats
    gain: float
    mended: _Assumed


@dataclass(frozen=True)
class _Fit:
    """Coefficients (n,) of samples, their residuals' root mean square (l/min), rows that count.

    ``left_out`` (N,) are the intervals that were not used.
    """

    theta: Floats
    rms: float
    rows: float
    left_out: Flags


class _Fitted(NamedTuple):
    """Assumptions, and their fit to all usable intervals."""

    assumed: _Assumed
    fit: _Fit


def _likeliest(shown: _Assumed, together: float) -> _Likeliest | None:
    """Return the variant that fits best, or None: none is significantly better.

    Play and spool are searched for the samples as shown, too: a delay gains nothing that a spool
    explains. Both are fitted to the same intervals. Another zero moves some below the lowest
    pressure, and the residuals of other rows have another mean square, by chance: with 0.5 mm of
    noise in the position by more than what is significant.
    """

    def fitted(tried: _Assumed, left_out: Flags | None = None) -> _Fit:
        state, trace = tried.summed(left_out)
        rows = 2.0 * float(state.squares[2]) / together
        return _Fit(*compared(state), rows, trace.reason != kernel.USED)

    def alike(one: _Fitted, other: _Fitted) -> tuple[_Fit, _Fit, float]:
        """Return the fits of both to the same intervals, and the gain by the other."""
        A, B = one.fit, other.fit
        if not np.array_equal(A.left_out, B.left_out):
            either = A.left_out | B.left_out
            A, B = fitted(one.assumed, either), fitted(other.assumed, either)
        return A, B, 2.0 * A.rows * math.log(max(A.rms, 1e-9) / max(B.rms, 1e-9))

    shown = shown.with_spool()
    unmended = _Fitted(shown, fitted(shown))
    best: _Likeliest | None = None
    for words, sizes, variant in _variants(shown):
        mended, last = unmended, math.nan
        for size in sizes:
            assumed = variant(shown, size)
            tried = _Fitted(assumed, fitted(assumed))
            step = alike(mended, tried)[2]
            if step < -SIGNIFICANT and size != sizes[0]:  # 40 ms may be too little
                break
            if step > 0.0:
                mended, last = tried, size
        if mended is unmended:
            continue
        one, other, gain = alike(unmended, mended)
        if gain > max(SIGNIFICANT, best.gain if best else 0.0):
            change, by = other.theta - one.theta, words.format(last)
            best = _Likeliest(words, by, one.theta, change, gain, mended.assumed)
    return best


def _variants(shown: _Assumed) -> Iterator[tuple[str, tuple[float, ...], _Variant]]:
    """Yield variants: words with a place for the size, sizes away from none, function.

    A delay that the fit cannot learn is seen by it as a smaller one: without any, none is tried.
    U is tried late alone: what is early is a slow spool.
    """
    period_s = shown.regression.period_s
    step_ms = 1e3 * max(round(LATE_S / period_s), 1) * period_s
    late_ms = tuple(step_ms * k for k in range(2, round(1e3 * MOST_LATE_S / step_ms) + 1))
    zeros = tuple(ZERO_BAR * k for k in range(1, MOST + 1))
    if np.abs(shown.theta[_DELAYS]).max() > LATE_SEEN:
        for sign, how in ((-1, "late"), (1, "early")):
            of_piston = _with_its_spool(_moved(("x", "v"), sign, period_s), -sign)
            yield f"position or speed {{:.0f}} ms too {how}", late_ms, of_piston
            of_pressures = _with_its_spool(_moved(PRESSURES, sign, period_s), 0)
            yield f"the pressures {{:.0f}} ms too {how}", late_ms, of_pressures
        of_U = _with_its_spool(_moved(("U",), -1, period_s), -1)
        yield "U {:.0f} ms too late", late_ms, of_U
    for name in PRESSURES:
        for sign, how in ((-1, "high"), (1, "low")):
            yield f"{name} {{:.0f}} bar too {how}", zeros, _raised(name, sign)
        yield f"{name} noisy", (0.0,), _smoothed(name)
    yield "U faster than the spool, which moves by {:.0f} %/s at most", SLEWS, _slewed(period_s)


def _with_its_spool(variant: _Variant, sign: int) -> _Variant:
    """Return the variant with its spool searched, also from a delay that is ``sign``·ms less."""
    return lambda shown, ms: variant(shown, ms).with_spool(1e-3 * sign * ms)


def _moved(names: tuple[str, ...], sign: int, period_s: float) -> _Variant:
    """Return a variant with signals at another time; beyond the recording they are missing.

    Signals have no other delay beside.
    """

    def variant(shown: _Assumed, ms: float) -> _Assumed:
        by, N = sign * round(1e-3 * ms / period_s), len(shown.samples)
        at = np.arange(N) - by
        there, at = (at >= 0) & (at < N), np.clip(at, 0, N - 1)
        return shown._replace(theta=np.zeros_like(shown.theta)).showing(
            **{name: np.where(there, getattr(shown.samples, name)[at], np.nan) for name in names}
        )

    return variant


def _raised(name: str, sign: int) -> _Variant:
    return lambda shown, bar: shown.showing(**{name: getattr(shown.samples, name) + sign * bar})


def _smoothed(name: str) -> _Variant:
    def variant(shown: _Assumed, _: float) -> _Assumed:
        half = SMOOTHED // 2
        beside = np.pad(getattr(shown.samples, name), half, mode="edge")
        mean = np.convolve(beside, np.full(SMOOTHED, 1.0 / SMOOTHED), "valid")
        return shown.showing(**{name: mean})

    return variant


def _slewed(period_s: float) -> _Variant:
    def variant(shown: _Assumed, slew: float) -> _Assumed:
        U = np.empty_like(shown.samples.U)
        limited(shown.samples.U, slew * period_s, U)
        return shown.showing(U=U)

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
