"""Support of the maps of a valve's estimators, stored once for estimators with the same samples.

Support records in which cells samples lie, independently of the estimator. A valve's estimators
share one row of it until one of them uses other samples, is reset, or is restored from another
state; it then gets a row of its copy. Rows are separated by comparing the samples used and the
stored bits, so sharing changes no result.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Codes, Flags, Samples, Segments, Times, field_names
from valvemap.model.support import Support, SupportOfMany
from valvemap.pipeline.lane_failures import CopyBuffer, Restore, rows_of
from valvemap.vocabulary.statuses import Status

SPARE = 8  # if no row is free, one row is added for every 8


class SharedSupport:
    """Support of the maps of E estimators of M valves.

    Parameters
    ----------
    nothing
        The support before the first sample.
    E, M
        Number of estimators and valves.

    Examples
    --------
    >>> shared = SharedSupport(Support.none(), E=4, M=1)
    >>> U, status = np.full(8, 50.0), np.zeros(8, np.uint8)
    >>> samples, rows = Samples.of(np.arange(8), U, U, 0 * U, U), Segments.one(8)
    >>> shared.learn(samples, [(status, rows)] * 4, rows)
    >>> shared.rows
    1
    >>> shared.put(1, 0, Support.none())
    >>> shared.rows
    2
    >>> len(shared.one(0, 0).boxes), len(shared.one(1, 0).boxes)
    (1, 0)
    """

    def __init__(self, nothing: Support, E: int, M: int) -> None:
        self._kept = nothing.of_many(M)
        self._of = np.tile(np.arange(M), (E, 1))  # row of each estimator and valve, (E, M)
        self._users = np.full(M, E)  # number of estimators that use each row
        self._free: list[int] = []  # unused rows

    @property
    def rows(self) -> int:
        """Number of rows in use."""
        return len(self._users) - len(self._free)

    def learn(
        self, samples: Samples, said: Sequence[tuple[Codes, Segments]], segments: Segments
    ) -> None:
        """Add samples to the support of each estimator that used them.

        Parameters
        ----------
        samples
            N samples.
        said
            For each estimator, the status of each sample (N,) and the segments of samples in its
            present maps: ``segments``, some with a later start.
        segments
            Assignment of the samples to valves.
        """
        if len(said) > 1:
            learnt = np.stack([_learnt(status, own, segments) for status, own in said])
            if (learnt != learnt[0]).any():
                self._part(learnt, segments)
        for e, (status, own) in enumerate(said):
            rows = self._of[e, own.members]
            first = ~(self._of[:e, own.members] == rows).any(axis=0)
            if first.any():
                chosen = own._replace(members=rows).of(first)
                self._kept.learn(samples, status, chosen)

    def saved(self, members: Times, buffer: CopyBuffer) -> Restore:
        """Copy the support of the given valves' maps; the result writes the copies back."""
        if len(self._of) == 1:
            rows, copy_of = self._of[0, members], np.arange(len(members))
        else:
            rows, copy_of = np.unique(self._of[:, members], return_inverse=True)
        at, where = copy_of.reshape(-1, len(members)), rows_of(rows)
        copies = buffer.copies(self._arrays, where)

        def restore() -> None:  # `learn` may have moved an estimator to another row
            for array, copy in zip(self._arrays, copies, strict=True):
                array[self._of[:, members]] = copy[at]

        return restore

    @property
    def _arrays(self) -> list[NDArray[Any]]:
        return [getattr(self._kept, name) for name in field_names(SupportOfMany)]

    def one(self, e: int, m: int) -> Support:
        """Return a copy of the support of one estimator's map."""
        return self._kept.one(self._of[e, m])

    def view(self, e: int, m: int) -> Support:
        """Return the support of one estimator's map, not copied."""
        return self._kept.view(self._of[e, m])

    def put(self, e: int, m: int, support: Support) -> None:
        """Replace the support of one estimator's map."""
        others = np.delete(self._of[:, m], e)
        for row in others.tolist():
            if _is_same(self._kept.one(row), support):
                self._move(e, m, row)
                return
        if self._of[e, m] in others:
            self._move(e, m, self._spare_row())
        self._kept.put(self._of[e, m], support)

    def columns(self, e: int) -> Mapping[str, NDArray[Any]]:
        """Return copies of the support of one estimator's maps, (M, …)."""
        kept, rows = self._kept, self._of[e]
        return {"seen": kept.cells[rows], "fit": kept.fit[rows], "ranges": kept.ranges[rows]}

    def take_up(self, e: int, columns: Mapping[str, NDArray[Any]]) -> None:
        """Restore the support of one estimator's maps from written columns."""
        every = SupportOfMany(columns["seen"], columns["fit"], columns["ranges"])
        for m in range(self._of.shape[1]):
            self.put(e, m, every.one(m))

    def _part(self, learnt: Flags, segments: Segments) -> None:
        """Separate estimators that share a row but used different samples, ``learnt`` (E, N)."""
        differ = np.concatenate([[0], np.cumsum((learnt != learnt[0]).any(axis=0))])
        apart = differ[segments.stops] > differ[segments.starts]
        for m, start, stop in zip(*segments.of(apart), strict=True):
            for row in np.unique(self._of[:, m]):
                alike: dict[bytes, list[int]] = {}
                for e in np.flatnonzero(self._of[:, m] == row):
                    alike.setdefault(learnt[e, start:stop].tobytes(), []).append(int(e))
                for parted in list(alike.values())[1:]:
                    copied = self._kept.one(row)
                    spare = self._spare_row()
                    for who in parted:
                        self._move(who, int(m), spare)
                    self._kept.put(spare, copied)

    def _spare_row(self) -> int:
        """Return an unused row, adding rows if there is none."""
        if not self._free:
            size = len(self._users)
            more = size // SPARE + 1
            self._kept = SupportOfMany(
                *(_longer(getattr(self._kept, name), more) for name in field_names(SupportOfMany))
            )
            self._users = _longer(self._users, more)
            self._free = list(range(size, size + more))
        return self._free.pop()

    def _move(self, e: int, m: int, row: int) -> None:
        """Assign one estimator of a valve to another row, which is already in use or reserved."""
        before = self._of[e, m]
        self._of[e, m] = row
        self._users[row] += 1
        self._users[before] -= 1
        if not self._users[before]:
            self._free.append(int(before))


def _learnt(status: Codes, own: Segments, segments: Segments) -> Flags:
    """Mask of the samples (N,) that are added to a map's support."""
    learnt = status <= Status.UNEXCITED
    for k in np.flatnonzero(own.starts > segments.starts):
        learnt[segments.starts[k] : own.starts[k]] = False
    return np.asarray(learnt)


def _is_same(one: Support, other: Support) -> bool:
    """Whether two supports are bitwise equal."""
    pairs = ((getattr(one, name), getattr(other, name)) for name in field_names(Support))
    return all(a.tobytes() == np.asarray(b, a.dtype).tobytes() for a, b in pairs)


def _longer(array: NDArray[Any], more: int) -> NDArray[Any]:
    return np.concatenate([array, np.zeros((more, *array.shape[1:]), array.dtype)])


@dataclass(frozen=True)
class SharedRests:
    """The support of one estimator's maps, a view of the support shared by all estimators."""

    shared: SharedSupport
    number: int

    def one(self, m: int) -> Support:
        """Return a copy of the support of valve ``m``."""
        return self.shared.one(self.number, m)

    def view(self, m: int) -> Support:
        """Return the support of valve ``m``, not copied."""
        return self.shared.view(self.number, m)

    def put(self, m: int, support: Support) -> None:
        """Replace the support of valve ``m``."""
        self.shared.put(self.number, m, support)

    def columns(self) -> Mapping[str, NDArray[Any]]:
        """Return the support of all valves as named arrays."""
        return self.shared.columns(self.number)

    def take_up(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Restore the support from the written arrays of `columns`."""
        self.shared.take_up(self.number, arrays)
