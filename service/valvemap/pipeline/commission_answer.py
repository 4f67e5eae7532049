"""Whether the flow still answers to U: a likelihood ratio that waits for no fixed time. Pure.

Two explanations of the newest openings Q/√Δp are compared, from every sample of a short memory on.
The memory goes by the source's clock and by every sample's U, so that it is the same however late
and in whatever bunches the samples are delivered:

- the spool *follows* U, behind some play and lag: the opening is the map's there, but for a
  constant;
- the spool *stands*: the opening is a constant, within the meter's noise.

Each opening is compared with the map as it was before it learnt that sample. The map's own standard
deviation weighs its errors, so a map that is not known yet, or is flat, is no evidence. The
constant takes up an error that a map has in common there: each fit has its own. How well maps
predicted before the memory began widens their standard deviation, and tells the plays and lags
apart: those that predicted worse must make up for it.
"""

import math
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Floats

PLAYS: Final = (0.0, 0.02, 0.04, 0.08, 0.12)  # shares of the range of U that a play may take
LAGS_S: Final = (0.0, 0.05, 0.15)  # s; of the spool behind each play
SPOOLS: Final = tuple(product(LAGS_S, PLAYS))
TRAVEL: Final = 0.01  # share of the range of U between two remembered samples
EVERY_NS: Final = 40_000_000  # ns; between them by the source's clock, else their errors are one
FORETOLD: Final = 0.1  # share of the range of U in a stretch by which a map is judged
LEAST: Final = 3  # rows: a constant, and what tells whether it is one
PROVEN: Final = 2  # stretches that a map must have foretold
MOST: Final = 40  # remembered samples
CLIPPED: Final = 8.0  # log likelihood; most that one sample tells
STANDS: Final = 16.0  # log likelihood ratio above which the spool stands
SURPRISE: Final = 1.5 * STANDS  # most that earlier predictions tell against a play and lag


@dataclass(frozen=True)
class Expected:
    """What the map predicts on a regular grid: openings and standard deviations, l/min/√bar.

    ``U`` (n,) in %, ``s`` (m,) the square root of the pressure drop, √bar; ``opening`` and ``std``
    (m, n). ``known`` (n,) says where U was seen; ``number`` is that of the fit; ``noise`` is the
    part of ``std`` that is the meter's, l/min.
    """

    U: Floats
    s: Floats
    opening: Floats
    std: Floats
    known: NDArray[np.bool_]
    number: int = 0
    noise: float = math.inf

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
class Row:
    """A remembered sample: its opening, and what was expected of it, per spool of `SPOOLS`.

    ``number`` is that of the fit, ``noise`` the meter's.
    ``against`` is the log likelihood by which earlier predictions of a spool were worse than the
    best; ``wider`` the factor of ``std`` by their errors.
    """

    opening: float
    U: tuple[float, ...]
    predicted: tuple[float, ...]
    std: tuple[float, ...]
    against: tuple[float, ...]
    wider: float
    number: int = 0
    noise: float = math.inf

    @property
    def is_known(self) -> bool:
        """Whether a map predicted it, wherever its spool is."""
        return all(map(math.isfinite, self.std))


@dataclass(frozen=True)
class Proof:
    """How well maps foretold what came next.

    ``errors`` are the RMS errors, in standard deviations, of the newest `PROVEN` stretches in which
    U travelled, about each fit's mean and behind the likeliest spool; ``against`` as in `Row`.
    ``stretch`` are the rows of the one that has not ended.
    """

    errors: tuple[float, ...] = ()
    against: tuple[float, ...] = (0.0,) * len(SPOOLS)
    stretch: tuple[Row, ...] = ()

    @property
    def wider(self) -> float:
        """Factor of a map's standard deviation; infinite while it has foretold too little."""
        return max(1.0, *self.errors) if len(self.errors) == PROVEN else math.inf

    def after(self, row: Row, span: float) -> "Proof":
        """Return it after one more row; rows where no map is known tell nothing."""
        if not row.is_known:
            return self
        stretch = (*self.stretch, row)
        U = [one.U[0] for one in stretch]
        free = len(stretch) - len({one.number for one in stretch})
        if max(U) - min(U) < FORETOLD * span or free < LEAST - 1:
            return replace(self, stretch=stretch)
        error = _opening(stretch) - _of(stretch, "predicted")
        z2 = _squares(error, _of(stretch, "std"), _fits(stretch))[:, -1].sum(axis=1) / free
        found = np.array(self.against) + 0.5 * z2 / max(1.0, float(z2.min()))
        found = np.minimum(found - found.min(), SURPRISE)
        error_RMS = math.sqrt(float(z2[found.argmin()]))
        return Proof((*self.errors[1 - PROVEN :], error_RMS), tuple(found.tolist()))


@dataclass(frozen=True)
class Answers:
    """Memory: `Row` by row, and how well maps foretold them.

    ``t`` is the time of the newest sample, ``kept`` that of the newest row, ns by the source's
    clock; ``spools`` is U behind each of `SPOOLS` at the newest sample.
    """

    rows: tuple[Row, ...] = ()
    t: int = -(2**63)
    kept: int = -(2**63)
    spools: tuple[float, ...] = ()
    proof: Proof = field(default_factory=Proof)

    def after(
        self, t: int, U: float, opening: float, s: float, span: float, expected: Expected | None
    ) -> "Answers":
        """Return it with a sample, which is remembered unless U or time have hardly moved.

        ``expected`` is of a map that has not learnt the sample. A sample that is not newer is
        known.
        """
        if t <= self.t:
            return self
        spools = self._followed(1e-9 * (t - self.t), U, span) if self.spools else (U,) * len(SPOOLS)
        near = bool(self.rows) and abs(U - self.rows[-1].U[0]) < TRAVEL * span
        if self.rows and (t - self.kept < EVERY_NS or near):
            return replace(self, t=t, spools=spools)
        row = _row(opening, s, spools, expected, self.proof)
        rows = (*self.rows[1 - MOST :], row)
        return Answers(rows, t, t, spools, self.proof.after(row, span))

    def begun_anew(self) -> "Answers":
        """Return it without samples, after a pause; how well maps foretold is kept."""
        return Answers(proof=replace(self.proof, stretch=()))

    def _followed(self, passed_s: float, U: float, span: float) -> tuple[float, ...]:
        """Return where the spools are after ``passed_s`` towards U; those of a lag at its pace."""
        found = list[float]()
        for x, (lag_s, play) in zip(self.spools, SPOOLS, strict=True):
            left = math.exp(-passed_s / lag_s) if lag_s > 0.0 else 0.0
            end = min(max(x, U - 0.5 * play * span), U + 0.5 * play * span)
            found.append(end + left * (x - end))
        return tuple(found)


def standing(answers: Answers) -> float:
    """Return the log likelihood ratio of a spool that stands to one that follows.

    Of the part of the memory, to its end, in which it is largest; 0 without a map.
    """
    rows = tuple(row for row in answers.rows[::-1] if row.is_known)  # the newest first
    if len(rows) < LEAST:
        return 0.0
    std, opening = _of(rows, "std"), _opening(rows)
    widened = np.array([row.wider for row in rows])[:, None] ** 2  # as it was when k rows began
    off = _squares(opening - _of(rows, "predicted"), std, _fits(rows)) / widened
    noise = np.array([[row.noise for row in rows]])
    still = _squares(opening[:1], noise, np.zeros(len(rows), np.int64))
    follows, stands = (np.minimum(0.5 * z2, CLIPPED).sum(axis=2) for z2 in (off, still))
    ratio = (follows + _of(rows, "against")).min(axis=0) - stands[0]
    return max(float(ratio.max()), 0.0)


def _row(
    opening: float, s: float, spools: tuple[float, ...], expected: Expected | None, proof: Proof
) -> Row:
    """Return a sample as it is remembered; the standard deviation is infinite without a map."""
    if expected is None:
        nothing = (0.0,) * len(spools), (math.inf,) * len(spools)
        return Row(opening, spools, *nothing, proof.against, proof.wider)
    predicted, std = expected.at(np.array(spools)[:, None], np.array([s]))
    known = tuple(predicted[:, 0].tolist()), tuple(std[:, 0].tolist())
    return Row(
        opening, spools, *known, proof.against, proof.wider, expected.number, expected.noise / s
    )


def _of(rows: tuple[Row, ...], name: str) -> Floats:
    """A field of N rows, (spools, N)."""
    return np.array([getattr(row, name) for row in rows]).T


def _opening(rows: tuple[Row, ...]) -> Floats:
    return np.tile([row.opening for row in rows], (len(SPOOLS), 1))


def _fits(rows: tuple[Row, ...]) -> NDArray[np.int64]:
    return np.array([row.number for row in rows])


def _squares(x: Floats, std: Floats, fits: NDArray[np.int64]) -> Floats:
    """Squares of the first k values about their mean of each fit, in their variance.

    Returns (spools, k, row); 0 for rows from k on.
    """
    N, weight = x.shape[1], std**-2.0
    of_k = np.tri(N, dtype=bool)  # row < k
    mean = np.zeros((len(x), N, N))
    for fit in np.unique(fits):
        own = fits == fit
        total = np.cumsum(np.where(own, weight, 0.0), axis=1)
        sums = np.cumsum(np.where(own, weight * x, 0.0), axis=1)
        of_fit = np.divide(sums, total, out=np.zeros_like(sums), where=total > 0.0)
        mean[:, :, own] = of_fit[:, :, None]
    return np.asarray(np.where(of_k, weight[:, None, :] * (x[:, None, :] - mean) ** 2, 0.0))
