"""Errors of a valve's estimators at places that it comes back to, and which of them to use. Pure.

A place is a cell of (U, sign(dp)·√|dp|, T). Two errors at places tell how good a *map* is:

- the error of the first samples of a visit, predicted by the map from before the visit;
- the error of the newest map at the first sample of each place's newest visit, evaluated at fixed
  numbers of samples (`Places.due`).

The first is an error of prediction, the second one of memory: an estimator with a short memory
follows the flow from sample to sample and is wrong where it was before. Where play or a lag lies
between map and samples, and the estimator knows it, a sample in motion shows another flow than the
map: there the smaller of the two errors counts.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Codes, Floats, Samples, Segments, Times
from valvemap.pipeline.kept_places import named, pack, unpack
from valvemap.pipeline.kernels import place_layout as layout
from valvemap.pipeline.kernels.place_layout import Record, Scratch
from valvemap.pipeline.kernels.places import Seen, learn
from valvemap.pipeline.lane_failures import CopyBuffer, Restore, saved
from valvemap.pipeline.map_errors import MapErrors
from valvemap.pipeline.place_errors import clipped, diagnose, note_past
from valvemap.pipeline.place_ranking import Ranking, chosen_of, rank, ranking_of
from valvemap.vocabulary.statuses import Adaptation

FIRST_LOOK: Final = 128  # samples until the maps are first evaluated at places left
LATEST_LOOK: Final = 4096  # samples; most between evaluations
GROWTH: Final = 1  # an evaluation after every 1/GROWTH of the age: at first it doubles


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
        self._record = _nothing_seen(E, M)
        C = layout.PLACES
        self._scratch = Scratch(
            np.zeros(C, np.int64),
            np.zeros((C, layout.OF_POINT), np.float32),
            np.zeros((E, C, layout.OF_PLACE), np.float32),
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
        learn(seen, residual, early, status, self._record, self._scratch, segments)

    def due(self, members: Times) -> Times:
        """Return after how many further samples `look_back` is due at each given valve (K,)."""
        valves = self._record.valves[members]
        return np.asarray((valves[:, layout.DUE] - valves[:, layout.TAKEN]).astype(np.int64))

    def points(self, m: int) -> tuple[Floats, Floats, Floats]:
        """Return U, dp and T (P,) of the newest visit's first sample at each place of a valve."""
        points = self._record.points[m][self._record.seen[m] > 0].astype(np.float64)
        U, dp, T = np.ascontiguousarray(points[:, : layout.AT_Q].T)
        return U, dp, T

    def look_back(
        self,
        m: int,
        maps: Sequence[tuple[Floats, Floats] | None],
        follows: Sequence[bool] = (),
    ) -> None:
        """Compare the newest maps of a valve's E estimators at its places, and rank them.

        Parameters
        ----------
        m
            The valve.
        maps
            Each estimator's flow and standard deviation at `points`; None: it has stopped.
        follows
            Whether each knows of something between its map and the samples; none of them, if empty.
        """
        valve = self._record.valves[m]
        taken = int(valve[layout.TAKEN])
        valve[layout.DUE] = taken + min(max(taken // GROWTH, FIRST_LOOK), LATEST_LOOK)
        known = self._record.seen[m] > 0
        if not known.any():
            return
        Q = self._record.points[m, known, layout.AT_Q].astype(np.float64)
        errors = np.full((len(maps), len(Q)), np.nan)
        for e, found in enumerate(maps):
            if found is not None:
                errors[e] = Q - found[0]
        for e in np.flatnonzero(follows).tolist():
            past = self._record.places[m, e, known, layout.PAST]
            errors[e] = np.where(np.abs(past) < np.abs(errors[e]), past, errors[e])
        squares = clipped(errors)
        least = np.nanmin(squares.mean(axis=1), initial=np.inf)
        for e, found in enumerate(maps):
            if found is not None:
                note_past(self._record, m, e, known, Q, errors[e], squares[e], found[1], least)
        rank(self._record, m, self._eligible)
        diagnose(self._record, m, least)

    def fits(self, members: Times) -> Codes:
        """Return what the errors say of the maps of the given valves, as `Adaptation`, (E, K)."""
        return np.asarray(self._record.lanes[members, :, layout.FIT].T.astype(np.uint8))

    def errors(self, members: Times, e: int) -> Floats:
        """Return the error of one estimator's maps at places left, without noise, l/min (K,)."""
        return np.asarray(np.sqrt(self._record.lanes[members, e, layout.EXCESS]))

    def ranking(self, m: int) -> Ranking:
        """Return the recommended estimator of one valve, as of the last `look_back`."""
        return ranking_of(self._record, m)

    def chosen(self, members: Times) -> Times:
        """Return the number of the recommended estimator of each given valve (K,); -1: none."""
        return chosen_of(self._record, members)

    def of(self, m: int, e: int) -> MapErrors:
        """Return a copy of the errors of one estimator's map."""
        record, lane = self._record, self._record.lanes[m, e]
        return MapErrors(
            axes=record.axes[m].copy(),
            seen=record.seen[m].copy(),
            past=record.places[m, e, :, layout.PAST].copy(),
            noise=float(lane[layout.PAST_NOISE]),
            excess=float(lane[layout.EXCESS]),
            tail=float(lane[layout.TAIL]),
            multiple=float(lane[layout.MULTIPLE]),
        )

    def reset(self, m: int, e: int) -> None:
        """Reset the errors of one estimator, after its own reset."""
        self._record.places[m, e] = 0.0
        self._record.lanes[m, e] = _no_errors()

    def accept(self, m: int, e: int) -> None:
        """Accept a restored map as one that predicts; a stored comparison replaces this."""
        self._record.lanes[m, e, layout.SKILLED] = 1.0

    def to_bytes(self, m: int, estimators: Mapping[str, str]) -> bytes:
        """Pack the places of one valve; ``estimators`` are the names and hashes of its E lanes."""
        return pack(self._record, m, estimators)

    def from_bytes(self, m: int, data: bytes, estimators: Mapping[str, str]) -> None:
        """Unpack the places of one valve; errors of other estimators are left out.

        Raises
        ------
        StateMismatchError
            if the bytes are damaged, or their content is invalid.
        """
        kept, before = unpack(data, lambda E: _nothing_seen(E, 1))
        record = self._record
        for name in ("axes", "valves", "seen", "points"):
            getattr(record, name)[m] = getattr(kept, name)
        for e, name in enumerate(named(estimators).tolist()):
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


def _nothing_seen(E: int, M: int) -> Record:
    axes = np.zeros((M, layout.AXES, layout.OF_AXIS))
    axes[..., layout.LOWER], axes[..., layout.HIGHER] = np.inf, -np.inf
    axes[..., layout.WIDTH] = layout.NARROWEST_U, layout.NARROWEST_S, layout.NARROWEST_T
    valves = np.zeros((M, layout.OF_VALVE))
    valves[:, layout.NOW], valves[:, layout.DUE] = -1.0, FIRST_LOOK
    C = layout.PLACES
    return Record(
        axes=axes,
        valves=valves,
        seen=np.zeros((M, C), np.int64),
        points=np.zeros((M, C, layout.OF_POINT), np.float32),
        places=np.zeros((M, E, C, layout.OF_PLACE), np.float32),
        lanes=np.tile(_no_errors(), (M, E, 1)),
    )


def _no_errors() -> Floats:
    lane = np.zeros(layout.OF_LANE)
    lane[[layout.MULTIPLE, layout.COVERED, layout.TAIL]] = 1.0
    lane[layout.SCORE], lane[layout.FIT] = np.inf, Adaptation.UNDECIDED
    return lane
