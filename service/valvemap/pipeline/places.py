"""Errors of a valve's estimators at places that it comes back to, and which of them to use. Pure.

A place is a cell of (U, sign(dp)·√|dp|, T). Two errors at places tell how good a *map* is:

- the error of the first samples of a visit, predicted by the map from before the visit;
- the error of the newest map at the first sample of each place's newest visit, evaluated at fixed
  numbers of samples (`Places.due`).

The first is an error of prediction, the second one of memory: an estimator with a short memory
follows the flow from sample to sample and is wrong where it was before.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.contents import Contents
from valvemap.model.estimator import State, StateMismatchError
from valvemap.model.samples import Codes, Flags, Floats, Samples, Segments, Times
from valvemap.pipeline.kernels import places as kernel
from valvemap.pipeline.kernels.places import Record, Scratch, Seen
from valvemap.pipeline.lane_failures import CopyBuffer, Restore, saved
from valvemap.pipeline.map_errors import MapErrors, shown_std
from valvemap.vocabulary.statuses import Adaptation

FIRST_LOOK: Final = 128  # samples until the maps are first evaluated at places left
LATEST_LOOK: Final = 4096  # samples; most between evaluations
GROWTH: Final = 1  # an evaluation after every 1/GROWTH of the age: at first it doubles
LOST: Final = 4.0  # times the variance of Q over places; a larger mean squared error is useless
FEWEST_PLACES: Final = 8  # places; with fewer, nothing is recommended
CERTAIN: Final = 3.0  # standard errors by which errors exceed the noise before intervals widen
OUTLYING_ALL, OUTLYING = 100.0, 25.0  # times the median square, of all and of one; larger: clipped
EXACT: Final = 1e-30  # (l/min)²; the square of a map without errors: 0 is one not evaluated
LATEST: Final = 0.05  # share of an earlier squared error that a later look back leaves at least
CLEARLY: Final = 2.0  # times; a squared error so much larger than another is another kind
SURE: Final = 0.9  # probability of being better at which another estimator is recommended


@dataclass(frozen=True)
class Ranking:
    """The recommended estimator of one valve.

    Attributes
    ----------
    chosen : int
        Its number; -1: none.
    sure : float
        Probability that it is better than the next best, 0 to 1.
    errors : (E,)
        Errors by which the estimators are ranked, l/min; infinite for those that are no candidates.
    places : int
        Number of places at which they are compared.
    U, dp : float
        The place at which fewest samples were judged, % and bar; NaN if there is none.
    """

    chosen: int
    sure: float
    errors: Floats
    places: int
    U: float = np.nan
    dp: float = np.nan


class Places:
    """The places of M valves, and the errors of E estimators there; updated in place.

    Parameters
    ----------
    E, M
        Number of estimators and valves.
    references
        Numbers of estimators that are never recommended.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> U, dp, e = rng.uniform(0, 100, 4000), rng.uniform(0, 200, 4000), rng.normal(0, 2, 4000)
    >>> samples = Samples.of(np.arange(4000), U, dp, 0 * dp, U + e)
    >>> places, status = Places(1, 1), np.zeros((1, 4000), np.uint8)
    >>> places.learn(samples, e[None], e[None], status, Segments.one(4000))
    >>> status[0, [0, 100]]
    array([1, 0], dtype=uint8)
    >>> places.look_back(0, [(places.points(0)[0], np.full(56, 0.1))])
    >>> places.ranking(0).errors.round()
    array([2.])
    """

    def __init__(self, E: int, M: int, references: Sequence[int] = ()) -> None:
        self._eligible = ~np.isin(np.arange(E), references)
        axes = np.zeros((M, kernel.AXES, kernel.OF_AXIS))
        axes[..., kernel.LOWER], axes[..., kernel.HIGHER] = np.inf, -np.inf
        axes[..., kernel.WIDTH] = kernel.NARROWEST_U, kernel.NARROWEST_S, kernel.NARROWEST_T
        valves = np.zeros((M, kernel.OF_VALVE))
        valves[:, kernel.NOW], valves[:, kernel.DUE] = -1.0, FIRST_LOOK
        C = kernel.PLACES
        self._record = Record(
            axes=axes,
            valves=valves,
            seen=np.zeros((M, C), np.int64),
            points=np.zeros((M, C, kernel.OF_POINT), np.float32),
            places=np.zeros((M, E, C, kernel.OF_PLACE), np.float32),
            lanes=np.tile(_no_errors(), (M, E, 1)),
        )
        self._scratch = Scratch(
            np.zeros(C, np.int64),
            np.zeros((C, kernel.OF_POINT), np.float32),
            np.zeros((E, C, kernel.OF_PLACE), np.float32),
        )

    def learn(
        self,
        samples: Samples,
        residual: Floats,
        early: Floats,
        status: Codes,
        segments: Segments,
    ) -> None:
        """Add N gated samples and the residuals (E, N) of E estimators.

        ``early`` (E, N) are the residuals of the maps as they were up to 31 samples before.
        ``status`` (E, N) is written: OK becomes WARMING_UP until the map has predicted better than
        the mean flow, and UNRELIABLE where its interval does not hold.
        """
        seen = Seen(samples.U, samples.dp, samples.T, samples.Q, samples.quality)
        kernel.learn(seen, residual, early, status, self._record, self._scratch, segments)

    def due(self, members: Times) -> Times:
        """Return after how many further samples `look_back` is due at each given valve (K,)."""
        valves = self._record.valves[members]
        return np.asarray((valves[:, kernel.DUE] - valves[:, kernel.TAKEN]).astype(np.int64))

    def points(self, m: int) -> tuple[Floats, Floats, Floats]:
        """Return U, dp and T (P,) of the newest visit's first sample at each place of a valve."""
        points = self._record.points[m][self._record.seen[m] > 0].astype(np.float64)
        U, dp, T = np.ascontiguousarray(points[:, : kernel.AT_Q].T)
        return U, dp, T

    def look_back(self, m: int, maps: Sequence[tuple[Floats, Floats] | None]) -> None:
        """Compare the newest maps of a valve's E estimators at its places, and rank them.

        Parameters
        ----------
        m
            The valve.
        maps
            Each estimator's flow and standard deviation at `points`; None: it has stopped.
        """
        valve = self._record.valves[m]
        taken = int(valve[kernel.TAKEN])
        valve[kernel.DUE] = taken + min(max(taken // GROWTH, FIRST_LOOK), LATEST_LOOK)
        known = self._record.seen[m] > 0
        if not known.any():
            return
        Q = self._record.points[m, known, kernel.AT_Q].astype(np.float64)
        errors = np.full((len(maps), len(Q)), np.nan)
        for e, found in enumerate(maps):
            if found is not None:
                errors[e] = Q - found[0]
        squares = _clipped(errors)
        least = np.nanmin(squares.mean(axis=1), initial=np.inf)
        for e, found in enumerate(maps):
            if found is not None:
                self._note_past(m, e, known, Q, errors[e], squares[e], found[1], least)
        self._rank(m)
        self._diagnose(m, least)

    def _diagnose(self, m: int, least: float) -> None:
        """Explain the errors of each map at the places left.

        Errors beyond the noise that another map does not have are misfit. The best map misfits,
        too, if it predicted these places as badly before; else the valve has moved since.
        """
        lanes = self._record.lanes[m]
        for e, lane in enumerate(lanes):
            if lane[kernel.PAST_SQUARE] == 0.0:
                lane[kernel.FIT] = Adaptation.UNDECIDED
            elif lane[kernel.EXCESS] == 0.0:
                lane[kernel.FIT] = Adaptation.STEADY
            elif lane[kernel.PAST_SQUARE] > CLEARLY * least:
                lane[kernel.FIT] = Adaptation.MISFIT
            else:
                place = self._record.places[m, e]
                judged = place[:, kernel.JUDGED] > 0.0
                again = float(place[judged, kernel.SQUARE].mean()) if judged.any() else 0.0
                stays = again - lane[kernel.PAST_NOISE] > lane[kernel.EXCESS] / CLEARLY
                lane[kernel.FIT] = Adaptation.MISFIT if stays else Adaptation.DRIFT

    def fits(self, members: Times) -> Codes:
        """Return what the errors say of the maps of the given valves, as `Adaptation`, (E, K)."""
        return np.asarray(self._record.lanes[members, :, kernel.FIT].T.astype(np.uint8))

    def errors(self, members: Times, e: int) -> Floats:
        """Return the error of one estimator's maps at places left, without noise, l/min (K,)."""
        return np.asarray(np.sqrt(self._record.lanes[members, e, kernel.EXCESS]))

    def _note_past(
        self,
        m: int,
        e: int,
        known: Flags,
        Q: Floats,
        errors: Floats,
        squares: Floats,
        std: Floats,
        least: float,
    ) -> None:
        """Store one estimator's errors at places left, and what of them is not noise."""
        lane, square, P = self._record.lanes[m, e], float(squares.mean()), len(errors)
        determined = np.isfinite(square)
        if not determined:
            lane[[kernel.PAST_SQUARE, kernel.PAST_NOISE, kernel.EXCESS, kernel.LOST]] = 0.0
            return
        noise = self._noise(m, e, known, errors, square, least)
        excess = square - noise if square > noise * (1.0 + CERTAIN * np.sqrt(2.0 / P)) else 0.0
        rank = math.ceil((1.0 - kernel.MISSES) * P) - 1
        quantile = float(np.partition(np.abs(errors), rank)[rank])
        tail = max(quantile / (kernel.GAUSSIAN * np.sqrt(square)), 1.0) if square > 0.0 else 1.0
        excess = max(excess, LATEST * float(lane[kernel.EXCESS]))
        lane[kernel.PAST_SQUARE] = max(square, LATEST * lane[kernel.PAST_SQUARE], EXACT)
        lane[kernel.PAST_NOISE], lane[kernel.EXCESS], lane[kernel.TAIL] = noise, excess, tail
        lane[kernel.LOST] = float(P >= FEWEST_PLACES and square > LOST * float(np.var(Q)))
        place = self._record.places[m, e]
        place[known, kernel.PAST] = errors
        shown = np.fmax(std, shown_std(errors**2, noise, excess, tail))
        place[known, kernel.STD] = np.nan_to_num(shown, nan=0.0, posinf=0.0)

    def _noise(
        self, m: int, e: int, known: Flags, errors: Floats, square: float, least: float
    ) -> float:
        """Return the variance of the measurement noise, no larger than the errors' mean square.

        It is seen in the residuals' differences from sample to sample at one place, and in the
        errors of the best estimator. Otherwise, in the differences between neighbouring places.
        """
        lane, found = self._record.lanes[m, e], square
        if lane[kernel.NOISE_N] > kernel.ENOUGH:
            found = min(found, float(lane[kernel.NOISE]))
        elif square <= least:
            grid = np.full(kernel.PLACES, np.nan)
            grid[known] = errors
            shape = kernel.PLACES_U, kernel.PLACES_S, kernel.PLACES_T
            steps = np.diff(grid.reshape(shape), axis=0)
            if np.isfinite(steps).any():
                found = min(found, float(np.nanmean(steps**2)) / 2.0)
        return min(found, least) if square > least else found

    def _rank(self, m: int) -> None:
        """Choose the estimator with the least error at places visited again."""
        lanes, before = self._record.lanes[m], self.chosen(np.array([m]))[0]
        lanes[:, kernel.SCORE], lanes[:, kernel.CHOSEN] = np.inf, 0.0
        missed = (lanes[:, kernel.COVERED_N] >= kernel.TRIED) & (
            lanes[:, kernel.COVERED] < kernel.HOLDS
        )
        able = (lanes[:, kernel.SKILLED] > 0.0) & (lanes[:, kernel.PAST_SQUARE] > 0.0)
        able &= self._eligible & ~missed & (lanes[:, kernel.LOST] == 0.0)
        candidates = np.flatnonzero(able)
        chosen = self._compared(m, candidates)
        if chosen.sum() < FEWEST_PLACES:
            return
        squares = self._record.places[m, candidates][:, chosen, kernel.SQUARE].astype(np.float64)
        again = _clipped(squares**0.5)
        past = lanes[candidates, kernel.PAST_SQUARE]
        mean = again.mean(axis=1)
        forgotten = np.maximum(past - past.min() - mean, 0.0)
        score = np.sqrt(mean + forgotten)
        lanes[candidates, kernel.SCORE] = score
        errors = again + forgotten[:, None]
        best, kept = int(np.argmin(score)), np.flatnonzero(candidates == before)
        if len(kept) and _sure(errors[[best, *kept]], 0) < SURE:
            best = int(kept[0])
        lanes[candidates[best], kernel.CHOSEN] = 1.0 + _sure(errors, best)

    def _compared(self, m: int, candidates: NDArray[np.intp]) -> Flags:
        """Mask (places,) of the places at which all candidates were judged."""
        if not len(candidates):
            return np.zeros(kernel.PLACES, np.bool_)
        judged = self._record.places[m, candidates, :, kernel.JUDGED] > 0.0
        return np.asarray(judged.all(axis=0))

    def ranking(self, m: int) -> Ranking:
        """Return the recommended estimator of one valve, as of the last `look_back`."""
        errors = self._record.lanes[m, :, kernel.SCORE].copy()
        compared = self._compared(m, np.flatnonzero(np.isfinite(errors)))
        chosen = int(self.chosen(np.array([m]))[0])
        sure = self._record.lanes[m, chosen, kernel.CHOSEN] - 1.0 if chosen >= 0 else 0.0
        known = np.flatnonzero(self._record.seen[m] > 0)
        U = dp = np.nan
        if len(known):
            judged = self._record.places[m, max(chosen, 0), known, kernel.JUDGED]
            U, dp = self._record.points[m, known[np.argmin(judged)], : kernel.AT_T].tolist()
        return Ranking(chosen, float(sure), errors, int(compared.sum()), U, dp)

    def chosen(self, members: Times) -> Times:
        """Return the number of the recommended estimator of each given valve (K,); -1: none."""
        marks = self._record.lanes[members, :, kernel.CHOSEN]
        return np.where(marks.any(axis=1), marks.argmax(axis=1), -1)

    def of(self, m: int, e: int) -> MapErrors:
        """Return a copy of the errors of one estimator's map."""
        record, lane = self._record, self._record.lanes[m, e]
        return MapErrors(
            axes=record.axes[m].copy(),
            seen=record.seen[m].copy(),
            past=record.places[m, e, :, kernel.PAST].copy(),
            noise=float(lane[kernel.PAST_NOISE]),
            excess=float(lane[kernel.EXCESS]),
            tail=float(lane[kernel.TAIL]),
            multiple=float(lane[kernel.MULTIPLE]),
        )

    def reset(self, m: int, e: int) -> None:
        """Reset the errors of one estimator, after its own reset."""
        self._record.places[m, e] = 0.0
        self._record.lanes[m, e] = _no_errors()

    def accept(self, m: int, e: int) -> None:
        """Accept a restored map as one that predicts; a stored comparison replaces this."""
        self._record.lanes[m, e, kernel.SKILLED] = 1.0

    def to_bytes(self, m: int, estimators: Mapping[str, str]) -> bytes:
        """Pack the places of one valve; ``estimators`` are the names and hashes of its E lanes."""
        arrays = {name: array[m] for name, array in self._record._asdict().items()}
        return _Kept(**arrays, estimators=_named(estimators)).to_bytes(_KEY)

    def from_bytes(self, m: int, data: bytes, estimators: Mapping[str, str]) -> None:
        """Unpack the places of one valve; errors of other estimators are left out.

        Raises
        ------
        StateMismatchError
            if the bytes are damaged, or their content is invalid.
        """
        kept = _Kept.from_bytes(data, _KEY)
        before = np.asarray(kept.estimators).tolist()
        if not isinstance(before, list):
            raise StateMismatchError("estimators is no list")
        blank = Places(len(before), 1)
        kept.check(
            _Kept(
                **{name: array[0] for name, array in blank.columns().items()},
                estimators=kept.estimators,
            )
        )
        record = self._record
        for name in ("axes", "valves", "seen", "points"):
            getattr(record, name)[m] = getattr(kept, name)
        for e, name in enumerate(_named(estimators).tolist()):
            self.reset(m, e)
            if name in before:
                row = before.index(name)
                record.places[m, e], record.lanes[m, e] = kept.places[row], kept.lanes[row]

    def columns(self) -> Mapping[str, NDArray[Any]]:
        """Return all arrays, each (M, …), not copied."""
        return self._record._asdict()

    def columns_of_valves(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that do not depend on the estimators, each (M, …), not copied."""
        return {n: getattr(self._record, n) for n in ("axes", "valves", "seen", "points")}

    def columns_of_lane(self, e: int) -> dict[str, NDArray[Any]]:
        """Return the arrays of one estimator, each (M, …), not copied."""
        return {"places": self._record.places[:, e], "errors": self._record.lanes[:, e]}

    def saved(self, members: Times, buffer: CopyBuffer) -> Restore:
        """Copy the places of the given valves; the result writes the copies back."""
        return saved(self._record, members, buffer)


_KEY: Final = "places 1"


@dataclass(frozen=True)
class _Kept(State):
    """The places of one valve as stored in a checkpoint; ``estimators`` (E,) are named by hash."""

    axes: Any
    valves: Any
    seen: Any
    points: Any
    places: Any
    lanes: Any
    estimators: Any

    def contents(self) -> Mapping[str, Contents]:
        """Return the permitted content."""
        every = slice(None)
        axes = Contents(self.axes)
        axes.within(-kernel.LARGEST, kernel.LARGEST, (every, [kernel.LOW, kernel.HIGH]))
        axes.within(kernel.NARROWEST_U, kernel.LARGEST, (every, kernel.WIDTH))
        axes.or_infinite((every, [kernel.LOWER, kernel.HIGHER]))
        valves = Contents(self.valves).within(0.0, _MOST)
        valves.within(-kernel.LARGEST, kernel.LARGEST, kernel.MEAN_Q)
        valves.within(0.0, 4.0 * kernel.LARGEST**2, kernel.VARIANCE_Q)
        valves.within(-1.0, kernel.PLACES - 1.0, kernel.NOW)
        points = Contents(self.points).or_nan((every, kernel.AT_T))
        positive = every, every, [kernel.JUDGED, kernel.SQUARE, kernel.STD]
        places = Contents(self.places).within(0.0, where=positive)
        lanes = Contents(self.lanes).within(0.0).or_infinite((every, kernel.SCORE))
        lanes.within(-kernel.LARGEST, kernel.LARGEST, (every, kernel.NEWEST))
        lanes.within(1.0 / kernel.WIDEST, kernel.WIDEST, (every, kernel.MULTIPLE))
        lanes.within(0.0, max(Adaptation), (every, kernel.FIT))
        lanes.within(0.0, 2.0, (every, kernel.CHOSEN))
        return {"axes": axes, "valves": valves, "points": points, "places": places, "lanes": lanes}


_MOST: Final = 2.0**53  # largest count that a float represents exactly


def _named(estimators: Mapping[str, str]) -> NDArray[np.str_]:
    return np.array([f"{name} {key}" for name, key in estimators.items()], np.str_)


def _no_errors() -> Floats:
    lane = np.zeros(kernel.OF_LANE)
    lane[[kernel.MULTIPLE, kernel.COVERED, kernel.TAIL]] = 1.0
    lane[kernel.SCORE], lane[kernel.FIT] = np.inf, Adaptation.UNDECIDED
    return lane


def _clipped(errors: Floats) -> Floats:
    """Squares of errors (E, P), outliers clipped: a spike would decide alone."""
    squares = errors**2
    if not np.isfinite(squares).any():
        return squares
    of_all = np.median(np.nanmin(np.where(np.isfinite(squares), squares, np.inf), axis=0))
    of_each = np.median(squares, axis=1, keepdims=True)
    clipped: Floats = np.minimum(squares, np.fmax(OUTLYING_ALL * of_all, OUTLYING * of_each))
    return clipped


def _sure(squares: Floats, best: int) -> float:
    """Probability that the next best estimator's error is larger; 1 if there is no other."""
    others = np.delete(squares, best, axis=0)
    if not len(others):
        return 1.0
    steps = others[np.argmin(others.mean(axis=1))] - squares[best]
    error = float(np.std(steps)) / np.sqrt(len(steps))
    if error == 0.0:
        return 0.5
    z = float(np.clip(steps.mean() / error, -8.0, 8.0))
    return 0.5 * (1.0 + math.erf(z / math.sqrt(2.0)))
