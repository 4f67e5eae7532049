"""Whether the flow still answers to U: a likelihood ratio that waits for no fixed time. Pure.

Two explanations of the newest openings Q/√Δp are compared, from every sample of a short memory on.
The memory goes by the source's clock and by every sample's U, so that it is the same however late
and in whatever bunches the samples are delivered:

- the spool *follows* U, behind some play and lag: the opening is the map's there, but for a
  constant;
- the spool *stands*: the opening is a constant.

The map's own standard deviation and the meter's noise weigh both, so a map that is not known yet,
or is flat, is no evidence. The constant takes up an error that the map has in common there.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Floats

PLAYS: Final = (0.0, 0.02, 0.04, 0.08, 0.12)  # shares of the range of U that a play may take
LAGS_S: Final = (0.0, 0.05)  # s; of the spool behind each play: after a pause U moves by jumps
TRAVEL: Final = 0.01  # share of the range of U between two remembered samples
EVERY_NS: Final = 40_000_000  # ns; between them by the source's clock, else their errors are one
FORETOLD: Final = 0.1  # share of the range of U in a stretch by which a map is judged
PROVEN: Final = 2  # stretches that a map must have foretold
MOST: Final = 40  # remembered samples
CLIPPED: Final = 8.0  # log likelihood; most that one sample tells
STANDS: Final = 16.0  # log likelihood ratio above which the spool stands


@dataclass(frozen=True)
class Expected:
    """What the map predicts on a regular grid: openings and standard deviations, l/min/√bar.

    ``U`` (n,) in %, ``s`` (m,) the square root of the pressure drop, √bar; ``opening`` and ``std``
    (m, n). ``known`` (n,) says where U was seen; ``wider`` is the factor of ``std`` by `Proof`.
    """

    U: Floats
    s: Floats
    opening: Floats
    std: Floats
    known: NDArray[np.bool_]
    wider: float = 1.0

    def at(self, U: Floats, s: Floats) -> tuple[Floats, Floats]:
        """Opening and standard deviation at U (k, N) and s (N,); infinite where not known."""
        x = (U - self.U[0]) / (self.U[1] - self.U[0])
        y = np.broadcast_to((s - self.s[0]) / (self.s[1] - self.s[0]), x.shape)
        inside = (x >= 0.0) & (x <= len(self.U) - 1) & (y >= 0.0) & (y <= len(self.s) - 1)
        i = np.clip(x.astype(np.int64), 0, len(self.U) - 2)
        j = np.clip(y.astype(np.int64), 0, len(self.s) - 2)
        a, b = np.clip(x - i, 0.0, 1.0), np.clip(y - j, 0.0, 1.0)

        def between(z: Floats) -> Floats:
            low = (1.0 - a) * z[j, i] + a * z[j, i + 1]
            high = (1.0 - a) * z[j + 1, i] + a * z[j + 1, i + 1]
            return np.asarray((1.0 - b) * low + b * high)

        opening, std = between(self.opening), between(self.std)
        seen = np.where(a < 0.5, self.known[i], self.known[i + 1])
        known = inside & seen & np.isfinite(opening) & np.isfinite(std)
        return np.where(known, opening, 0.0), np.where(known, std, np.inf)


@dataclass(frozen=True)
class Proof:
    """How well maps foretold what came next: errors in their standard deviations, RMS.

    ``errors`` are those of the newest `PROVEN` stretches in which U travelled; ``left`` the sum of
    squares, number, and lowest and highest U of the stretch that has not ended.
    """

    errors: tuple[float, ...] = ()
    left: tuple[float, float, float, float] = (0.0, 0.0, math.inf, -math.inf)

    @property
    def wider(self) -> float:
        """Factor of a map's standard deviation; infinite while it has foretold too little."""
        return max(1.0, *self.errors) if len(self.errors) == PROVEN else math.inf

    def after(self, expected: Expected | None, U: Floats, opening: Floats, s: Floats) -> "Proof":
        """Return it after N samples, which ``expected`` was made before."""
        if expected is None:
            return self
        predicted, std = (x[0] for x in expected.at(U[None, :], s))
        known = np.isfinite(std)
        if not known.any():
            return self
        U, z = U[known], ((opening - predicted) / std)[known]
        z2, n, low, high = self.left
        z2, n = z2 + float(z @ z), n + len(U)
        low, high = min(low, float(U.min())), max(high, float(U.max()))
        if high - low < FORETOLD * (expected.U[-1] - expected.U[0]):
            return replace(self, left=(z2, n, low, high))
        return Proof((*self.errors[1 - PROVEN :], math.sqrt(z2 / n)))


@dataclass(frozen=True)
class Answers:
    """Memory: rows of (opening, √Δp, U behind each of `PLAYS` and `LAGS_S`).

    ``t`` is the time of the newest sample, ``kept`` that of the newest row, ns by the source's
    clock; ``spools`` is U behind each play and lag at the newest sample.
    """

    rows: tuple[tuple[float, ...], ...] = ()
    t: int = -(2**63)
    kept: int = -(2**63)
    spools: tuple[float, ...] = ()

    def after(self, t: int, U: float, opening: float, s: float, span: float) -> "Answers":
        """Return it with a sample, which is remembered unless U or time have hardly moved.

        A sample that is not newer is known.
        """
        if t <= self.t:
            return self
        if not self.spools:
            spools = (U,) * len(PLAYS) * len(LAGS_S)
            return Answers(((opening, s, *spools),), t, t, spools)
        spools = self._followed(1e-9 * (t - self.t), U, span)
        if t - self.kept < EVERY_NS or abs(U - self.rows[-1][2]) < TRAVEL * span:
            return replace(self, t=t, spools=spools)
        return Answers((*self.rows[1 - MOST :], (opening, s, *spools)), t, t, spools)

    def _followed(self, passed_s: float, U: float, span: float) -> tuple[float, ...]:
        """Return where the spools are after ``passed_s`` towards U; those of a lag at its pace."""
        found = list[float]()
        for k, lag_s in enumerate(LAGS_S):
            left = math.exp(-passed_s / lag_s) if lag_s > 0.0 else 0.0
            before = self.spools[k * len(PLAYS) : (k + 1) * len(PLAYS)]
            for x, w in zip(before, PLAYS, strict=True):
                end = min(max(x, U - 0.5 * w * span), U + 0.5 * w * span)
                found.append(end + left * (x - end))
        return tuple(found)


def standing(expected: Expected | None, answers: Answers) -> float:
    """Return the log likelihood ratio of a spool that stands to one that follows.

    Of the part of the memory, to its end, in which it is largest; 0 without a map.
    """
    if expected is None or len(answers.rows) < 3:
        return 0.0
    rows = np.array(answers.rows[::-1])  # the newest first: sums over the newest k are cumulative
    opening, s = rows[:, 0], rows[:, 1]
    predicted, std = expected.at(rows[:, 2:].T, s)
    weight = 1.0 / (expected.wider * std) ** 2
    known = (weight > 0.0).all(axis=0)  # of every play and lag
    if known.sum() < 3:
        return 0.0
    opening, predicted, weight = opening[known], predicted[:, known], weight[:, known]
    follows = _misfit(opening - predicted, weight).min(axis=0)
    stands = _misfit(np.broadcast_to(opening, weight.shape), weight).max(axis=0)
    return max(float((follows - stands).max()), 0.0)


def _misfit(x: Floats, weight: Floats) -> Floats:
    """-Log likelihood of the newest k values about their mean, for each k, (plays, N)."""
    N = x.shape[1]
    total = np.cumsum(weight, axis=1)
    mean = np.cumsum(weight * x, axis=1) / total  # (plays, N), by k
    off = 0.5 * weight[:, None, :] * (x[:, None, :] - mean[:, :, None]) ** 2  # (plays, k, row)
    of_k = np.tri(N, dtype=bool)  # row ≤ k
    return np.asarray(np.where(of_k, np.minimum(off, CLIPPED), 0.0).sum(axis=2))
