"""Whether the flow still answers to U: a likelihood ratio that waits for no fixed time. Pure.

Two explanations of the newest openings Q/√Δp are compared, from every sample of a short memory on.
The memory goes by the source's clock and by every sample's U, so that it is the same however late
and in whatever bunches the samples are delivered:

- the spool *follows* U, behind some play and lag: the opening is the map's there, but for a
  constant;
- the spool *stands*: the opening is a constant, or the map's at a standing spool but for a
  constant, within the meter's noise. Where a compensator holds the flow, the second is meant.

Each opening is compared with the map as it was before it learnt that sample. A map's error is a
smooth function of U: over little travel it is in common, and the steps from sample to sample are
known better than the openings. It is a Gaussian process of the map's own standard deviation, and a
constant besides, for each fit; the meter's noise is white. A map that is not known yet, or is flat,
is so no evidence. How well maps predicted before the memory began widens all deviations, and tells
the plays and lags apart: those that predicted worse must make up for it.
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
EVERY_NS: Final = 40_000_000  # ns; between them by the source's clock
ALIKE: Final = 0.2  # share of the range of U over which the errors of a map are alike
ROUNDING: Final = 1e-12  # share of the largest variance that keeps a covariance regular
TINY: Final = 1e-300
CONSTANT: Final = 1e4  # standard deviation of a fit's constant, in those of the noise: any
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
    (m, n), of the map alone. ``known`` (n,) says where U was seen; ``number`` is that of the fit;
    ``noise`` is the meter's standard deviation, l/min.
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

    ``number`` is that of the fit ``expected``, ``noise`` the meter's; ``s`` is as in `Expected`.
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
    s: float = math.nan
    expected: Expected | None = None

    @property
    def is_known(self) -> bool:
        """Whether a map predicted it, wherever its spool is."""
        return all(map(math.isfinite, self.std))


@dataclass(frozen=True)
class Proof:
    """How well maps foretold what came next.

    ``errors`` are the RMS errors, in standard deviations, of the newest `PROVEN` stretches in which
    U travelled, behind the likeliest spool; ``against`` as in `Row`.
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
        z2 = _squares(stretch, span).sum(axis=1) / free
        found = np.array(self.against) + 0.5 * z2 / max(1.0, float(z2.min()))
        found = np.minimum(found - found.min(), SURPRISE)
        error_RMS = math.sqrt(float(z2[found.argmin()]))
        return Proof((*self.errors[1 - PROVEN :], error_RMS), tuple(found.tolist()))


@dataclass(frozen=True)
class Answers:
    """Memory: `Row` by row, and how well maps foretold them.

    ``t`` is the time of the newest sample, ``kept`` that of the newest row, ns by the source's
    clock; ``spools`` is U behind each of `SPOOLS` at the newest sample; ``span`` the range of U, %.
    """

    rows: tuple[Row, ...] = ()
    t: int = -(2**63)
    kept: int = -(2**63)
    spools: tuple[float, ...] = ()
    proof: Proof = field(default_factory=Proof)
    span: float = 100.0

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
        return Answers(rows, t, t, spools, self.proof.after(row, span), span)

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
    widened = np.array([row.wider for row in rows])[:, None] ** 2  # as it was when k rows began
    off = np.tril(np.ones((len(rows), len(rows)))) * _squares(rows, answers.span)[:, None] / widened
    follows = np.minimum(0.5 * off, CLIPPED).sum(axis=2)
    stands = np.cumsum(np.minimum(0.5 * _squares_at_rest(rows), CLIPPED))
    stands = np.minimum(stands, _stands_by_map(rows))
    ratio = (follows + _of(rows, "against")).min(axis=0) - stands
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
    proven, noise = (proof.against, proof.wider), expected.noise / s
    return Row(opening, spools, *known, *proven, expected.number, noise, s, expected)


def _of(rows: tuple[Row, ...], name: str) -> Floats:
    """A field of N rows, (spools, N)."""
    return np.array([getattr(row, name) for row in rows]).T


def _squares(rows: tuple[Row, ...], span: float) -> Floats:
    """Squares of what each row adds to those before it if the spool follows, (spools, N)."""
    fits = np.array([row.number for row in rows])
    U = np.array([row.U[0] for row in rows])
    travel = np.cumsum(np.abs(np.diff(U, prepend=U[0]))) / (ALIKE * span)
    alike = np.exp(-0.5 * (travel[:, None] - travel) ** 2)
    std, of_fit = _of(rows, "std"), fits[:, None] == fits
    common = std[:, :, None] * std[:, None, :] * alike
    opening = np.array([row.opening for row in rows])
    return _innovations(rows, opening - _of(rows, "predicted"), common * of_fit, of_fit)


def _squares_at_rest(rows: tuple[Row, ...]) -> Floats:
    """Squares of what each row adds to those before it if the spool stands, (N,)."""
    opening = np.array([[row.opening for row in rows]])
    every = np.ones((len(rows), len(rows)), dtype=bool)
    return np.asarray(_innovations(rows, opening, np.zeros((1, *every.shape)), every)[0])


def _stands_by_map(rows: tuple[Row, ...]) -> Floats:
    """Minus the log likelihood of the newest 1 … N rows at a spool that stands as the map has it.

    The spool stands where the oldest of them has it, and the map is the one of that row, (N,).
    """
    s, noise = np.array([row.s for row in rows]), np.array([row.noise for row in rows])
    opening, found = np.array([row.opening for row in rows]), np.full(len(rows), np.inf)
    for k, oldest in enumerate(rows):
        if oldest.expected is None:
            continue
        newer = slice(0, k + 1)
        predicted, std = oldest.expected.at(np.full(k + 1, oldest.U[0]), s[newer])
        if np.isfinite(std).all():
            off, w = opening[newer] - predicted, noise[newer] ** -2
            z2 = (off - (w * off).sum() / w.sum()) ** 2 * w
            found[k] = np.minimum(0.5 * z2, CLIPPED).sum()
    return found


def _innovations(
    rows: tuple[Row, ...], x: Floats, common: Floats, of_fit: NDArray[np.bool_]
) -> Floats:
    """Squares of the innovations of x (k, N) about constants, in their variance.

    ``common`` (k, N, N) is the covariance without constants and noise.
    """
    noise = np.array([row.noise for row in rows])
    constant = (CONSTANT * noise.max()) ** 2
    least = ROUNDING * (common.max() + constant) + TINY
    L = np.linalg.cholesky(common + constant * of_fit + np.diag(noise**2 + least))
    return np.asarray(np.linalg.solve(L, x[:, :, None])[:, :, 0] ** 2)
