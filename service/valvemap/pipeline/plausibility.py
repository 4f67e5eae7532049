"""Plausibility of a valve's signals, checked before they reach the estimators.

Swapped pressures, psi taken for bar, a flow meter of another pipe: each gives a map with an R² of
0.99, which a controller would follow. Impossible data are rejected unless ``insist`` is configured;
possible but suspicious data give a hint. Pure; samples are counted, so the result does not depend
on how they are cut into batches.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Floats, Samples, Segments, Times
from valvemap.pipeline.kernels import plausibility as kernel
from valvemap.vocabulary.statuses import Quality

SOME_BACKWARD: Final = 0.01  # share of samples; fewer backward times are clock steps
CLOCK_STEPS: Final = 2.0  # backward times; as few are clock steps, however few the samples
ENOUGH: Final = 2_000  # samples before a slope is judged
LEAST_SPREAD_S: Final = 0.5  # √bar, of √dp at a given U; less gives no slope
FALLING: Final = -0.2  # correlation of Q with √dp at a given U
NOT_RISING: Final = 0.02  # the same; noise alone gives this much
LEAST_FLOW: Final = 5.0  # l/min; a smaller flow is leakage and is ignored
CLIPPED: Final = 5  # samples at the very end of a range
_SPANS: Final = ((0.0, 10.0, "V"), (4.0, 20.0, "mA"))
_ROUNDING: Final = 1e-3  # of a span
_STILL: Final = 1e-9  # %²; with a smaller variance U is at rest
_PASCALS_FROM, _KILOPASCALS_FROM = 2e5, 1e4  # hydraulic pressures in Pa and kPa, read as bar


class Kind(Enum):
    """Severity of a finding."""

    REFUSED = "refused"
    HINT = "hint"


@dataclass(frozen=True)
class Finding:
    """A reason why a valve's signals are implausible; ``sentence`` gives it, and a remedy."""

    kind: Kind
    sentence: str


class Plausibility:
    """Statistics of M valves, updated in place.

    Examples
    --------
    >>> swapped = Samples.of(t=range(50), U=[50] * 50, p1=[10] * 50, p2=[100] * 50, Q=[30] * 50)
    >>> plausibility = Plausibility(1)
    >>> refused = plausibility.count(swapped, Segments.one(50))
    >>> [finding.sentence for finding in plausibility.findings(0)]
    ['p1 is below p2 in 100 % of the samples: are the two swapped?']
    """

    def __init__(self, M: int) -> None:
        self._counts: Floats = np.zeros((M, kernel.FIELDS))
        self._counts[:, kernel.LOWEST_U], self._counts[:, kernel.HIGHEST_U] = np.inf, -np.inf
        self._times: Times = np.zeros(M, np.int64)
        self._sums: Floats = np.zeros((M, kernel.CELLS, kernel.SUMS))

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return all statistics, each (M, …), not copied."""
        return {"counts": self._counts, "times": self._times, "sums": self._sums}

    def count(self, samples: Samples, segments: Segments) -> NDArray[np.bool_]:
        """Add N raw samples to the statistics; return the mask of rejected ones, (N,).

        Rejection starts at the first sample with impossible pressures and ends once ten times as
        many samples have been right. So a sensor that failed for seconds does not reject all later
        samples, while pressures in psi that are too high in each cycle are rejected throughout.
        """
        columns = np.empty((len(samples), 5))
        for k, column in enumerate((samples.U, samples.p1, samples.p2, samples.Q, samples.T)):
            columns[:, k] = column
        refused = np.empty(len(samples), np.bool_)
        counted = self._counts, self._times, self._sums
        kernel.count(samples.t, columns, samples.quality, *counted, segments, refused)
        return refused

    def refused(self) -> NDArray[np.bool_]:
        """Mask (M,) of the valves whose newest sample is rejected."""
        return np.asarray(self._counts[:, kernel.REFUSED] != kernel.NOT_REFUSED)

    def is_refuted(self, m: int) -> bool:
        """Whether one valve's flow and pressures, or its times, are inconsistent."""
        return any((*_of_slope(self._sums[m]), *_of_times(self._counts[m])))

    def findings(self, m: int) -> list[Finding]:
        """Return the reasons why one valve's signals are implausible, the most severe first."""
        own, sums = self._counts[m], self._sums[m]
        refused = [*(list(_of_pressures(own)) or _of_slope(sums)), *_of_times(own)]
        hints = [*_of_opening(own, sums), *_of_temperature(own), *_of_repeated_times(own)]
        return [
            *(Finding(Kind.REFUSED, sentence) for sentence in refused),
            *(Finding(Kind.HINT, sentence) for sentence in hints),
        ]


def refuse(samples: Samples, refused: NDArray[np.bool_]) -> Samples:
    """Return the N samples, with the rejected ones (N,) marked BAD."""
    if not refused.any():
        return samples
    quality = np.where(refused, np.uint8(Quality.BAD), samples.quality)
    return replace(samples, quality=quality)


def _of_pressures(own: Floats) -> Iterator[str]:
    if own[kernel.REFUSED] == kernel.TOO_HIGH:
        highest = own[kernel.HIGHEST_P]
        likely = f"is it {_likely_unit(highest)}? signals.p1.unit and signals.p2.unit say so"
        remedy = likely if highest > 0.0 else "has its sensor failed?"
        yield f"a pressure of {highest:.4g} bar is none of a hydraulic valve: {remedy}"
    elif own[kernel.REFUSED] == kernel.SWAPPED:
        share = 100.0 * own[kernel.REVERSED] / (own[kernel.REVERSED] + own[kernel.FORWARD])
        yield f"p1 is below p2 in {share:.0f} % of the samples: are the two swapped?"


def _likely_unit(highest: float) -> str:
    if highest > _PASCALS_FROM:
        return "Pa"
    return "kPa" if highest > _KILOPASCALS_FROM else "psi"


def _of_slope(sums: Floats) -> Iterator[str]:
    """Judge Q against √dp at a given U: partial correlation within cells of U, pooled."""
    rows = sums[sums[:, kernel.N] >= kernel.FEW]
    n, U, s, Q, UU, US, UQ, SS, SQ, QQ = rows.T
    U_U, U_s, U_Q = UU - U * U / n, US - U * s / n, UQ - U * Q / n
    by_U = np.where(_STILL * n < U_U, 1.0 / np.maximum(U_U, _STILL), 0.0)
    s_s = SS - s * s / n - U_s * U_s * by_U
    s_Q = SQ - s * Q / n - U_s * U_Q * by_U
    Q_Q = np.maximum(QQ - Q * Q / n - U_Q * U_Q * by_U, 0.0)
    flows = np.abs(Q / n) >= np.maximum(LEAST_FLOW, np.sqrt(Q_Q / n))
    chosen = flows & (s_s > LEAST_SPREAD_S**2 * n)
    if n[chosen].sum() < ENOUGH:
        return
    spread = np.sqrt(s_s[chosen].sum() * Q_Q[chosen].sum())
    r = s_Q[chosen].sum() / spread if spread > 0.0 else 0.0
    if r < FALLING:
        yield "Q falls where p1 - p2 rises: has one the wrong sign, or another valve's node?"
    elif r < NOT_RISING:
        yield "Q does not rise with p1 - p2: are they the flow and the pressures of this valve?"


def _of_times(own: Floats) -> Iterator[str]:
    steps, back = own[kernel.SEEN] - 1.0, own[kernel.BACKWARD]
    if steps < kernel.FEW or back <= _clock_steps(steps):
        return
    if back > kernel.NEARLY_ALWAYS * steps:
        yield "the times run backwards: sort the rows by t"
    else:
        yield f"the times step back at {back:.0f} of {steps + 1:.0f} samples: sort the rows by t"


def _clock_steps(steps: float) -> float:
    """Return the number of backward times that steps of the clock explain."""
    return max(CLOCK_STEPS, SOME_BACKWARD * steps)


def _of_repeated_times(own: Floats) -> Iterator[str]:
    steps, back, same = own[kernel.SEEN] - 1.0, own[kernel.BACKWARD], own[kernel.REPEATED]
    if steps >= kernel.FEW and same > SOME_BACKWARD * steps:
        yield (
            f"{same:.0f} of {steps + 1:.0f} samples have the time of the one before: are rows "
            "doubled, or were the times cut off?"
        )
    if 0.0 < back <= _clock_steps(steps):
        yield f"the times step back {back:.0f} times: are the files in order?"


def _of_opening(own: Floats, sums: Floats) -> Iterator[str]:
    """Judge U that covers a span of volts or mA from end to end, including the middle."""
    low, high = own[kernel.LOWEST_U], own[kernel.HIGHEST_U]
    clipped = min(own[kernel.AT_LOWEST], own[kernel.AT_HIGHEST]) >= CLIPPED
    for least, most, symbol in _SPANS:
        slack = _ROUNDING * (most - least)
        passes = sums[_cell(0.5 * (least + most)), kernel.N] >= kernel.FEW
        if clipped and passes and abs(low - least) <= slack and abs(high - most) <= slack:
            yield (
                f"U runs from {least:g} to {most:g} and is cut off at both ends: is it {symbol}? "
                f"signals.U.raw = [{least:g}, {most:g}] and range = [0, 100] say so"
            )


def _cell(U: float) -> int:
    width = (kernel.HIGHEST_CELL - kernel.LOWEST_CELL) / kernel.CELLS
    return int((U - kernel.LOWEST_CELL) / width)


def _of_temperature(own: Floats) -> Iterator[str]:
    if own[kernel.WITH_T] >= kernel.FEW and own[kernel.HOT] > 0.5 * own[kernel.WITH_T]:
        yield f"T is above {kernel.HOT_T:g} °C: is it °F or K? signals.T.unit says so"
