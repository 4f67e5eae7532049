"""Bulkheads: an exception in one lane (valve and estimator) stops only that lane. Pure.

A step works on many valves in one call. If it raises, its writes are undone and it is repeated
valve by valve. The valve at which it raises keeps its previous state and stops; all others get
the same bits as from one call. A step that belongs to one estimator stops that
lane, one that belongs to the valve stops all of its lanes, until an operator resets one of them.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Times

MOST_WAITING: Final = 100  # failures kept until they are logged; further ones are only counted
MOST_OF_A_REASON: Final = 200  # characters
SMALL: Final = 16_384  # bytes; smaller copies are allocated, from memory that Python has at hand
ALIGNED: Final = 64  # bytes; copies begin at a cache line

Rows = NDArray[np.intp]  # an alias: annotations of inner functions are evaluated at each call
Restore = Callable[[], None]
Stop = Callable[[int, Exception], None]


class Step(StrEnum):
    """A step of the work on a lane or a valve."""

    ALIGNMENT = "alignment"
    GATE = "gate"
    LEARNING = "learning"
    SUPPORT = "support"
    COMPARISON = "comparison"
    ALARMS = "alarms"
    MAP = "map"
    SURVEY = "survey"
    INVERSE = "inverse"
    RESULTS = "results"
    PUBLICATION = "publication"
    HISTORY = "history"
    RECORDING = "recording"
    CHECKPOINT = "checkpoint"


@dataclass(frozen=True)
class LaneFailure:
    """Why a lane stopped; ``estimator`` is None if all lanes of the valve stopped."""

    valve: str
    estimator: str | None
    step: Step
    error: Exception

    @property
    def reason(self) -> str:
        """One line that names lane, step and error."""
        lines = str(self.error).splitlines() or [""]
        said = f"{type(self.error).__name__}: {lines[0]}".rstrip(": ")
        text = f"{self.estimator or 'all estimators'}, {self.step}: {said}"
        return text.encode("ascii", "backslashreplace").decode()[:MOST_OF_A_REASON]


class LaneFailures:
    """Failures that are not yet logged.

    Attributes
    ----------
    count : int
        Number of all failures.
    """

    def __init__(self) -> None:
        self.count = 0
        self._waiting: list[LaneFailure] = []

    def note(self, failure: LaneFailure) -> None:
        """Store a failure until it is taken; beyond MOST_WAITING only count it."""
        self.count += 1
        if len(self._waiting) < MOST_WAITING:
            self._waiting.append(failure)

    def take_new(self) -> list[LaneFailure]:
        """Return and remove the stored failures."""
        taken, self._waiting = self._waiting, []
        return taken


def isolate(
    members: Times,
    do: Callable[[Rows], None],
    save: Callable[[Times], Restore],
    stop: Stop,
) -> None:
    """Call ``do`` for K valves together, or, if that raises, valve by valve.

    Parameters
    ----------
    members
        The valves (K,).
    do
        Called with rows of the K valves; writes in place.
    save
        Copies the arrays that `do` writes, for the given valves; its result writes them back.
    stop
        Called with a valve for which `do` raises, and the exception, after it was restored.

    Examples
    --------
    >>> total = np.zeros(3)
    >>> def add(rows):
    ...     total[rows] += 1.0
    ...     if 1 in rows:
    ...         raise ValueError("not this one")
    >>> save = lambda own: saved([total], own, CopyBuffer())
    >>> isolate(np.arange(3), add, save, lambda m, e: print(m, e))
    1 not this one
    >>> total
    array([1., 0., 1.])
    """
    if not len(members):
        return
    every = np.arange(len(members))
    restore = save(members)
    try:
        do(every)
    except Exception as error:  # noqa: BLE001 - a bulkhead: other lanes are not affected
        restore()
        if len(members) == 1:
            stop(int(members[0]), error)
            return
    else:
        return
    for k in every:
        one = every[k : k + 1]
        isolate(members[one], partial(_at, do, one), save, stop)


def _at(do: Callable[[Rows], None], one: Rows, _: Any) -> None:  # noqa: ANN401
    do(one)


def isolate_last(
    members: Times,
    do: Callable[[Rows], None],
    restore: Restore,
    stop: Stop,
) -> None:
    """As `isolate` for one valve; for several, re-raise: the outer `isolate` finds the valve.

    ``restore`` undoes what `do` writes, by the copy that the outer `isolate` has made.
    """
    if len(members) == 1:
        isolate(members, do, lambda _: restore, stop)
    elif len(members):
        do(np.arange(len(members)))


class CopyBuffer:
    """Memory for copies, reused by every step: fresh pages would cost more than the copies.

    Examples
    --------
    >>> buffer = CopyBuffer()
    >>> state = np.zeros((100, 1000))
    >>> restore = saved([state], np.arange(90), buffer)
    >>> state[:] = 1.0
    >>> restore()
    >>> state[89, 0], state[90, 0]
    (np.float64(0.0), np.float64(1.0))
    """

    def __init__(self) -> None:
        self._block = np.empty(0, np.uint8)
        self._used = 0

    def clear(self) -> None:
        """Reuse the memory of all earlier copies."""
        self._used = 0

    def copies(self, arrays: Iterable[NDArray[Any]], rows: slice | Times) -> list[NDArray[Any]]:
        """Copy rows of each array."""
        if not isinstance(rows, slice):
            return [self._taken(array, rows) for array in arrays]
        parts = [array[rows] for array in arrays]
        return [part.copy() if part.nbytes < SMALL else self._large(part) for part in parts]

    def _taken(self, array: NDArray[Any], rows: Times) -> NDArray[Any]:
        copied = self._like(array, len(rows))
        np.take(array, rows, axis=0, out=copied, mode="clip")
        return copied

    def _large(self, part: NDArray[Any]) -> NDArray[Any]:
        copied = self._like(part, len(part))
        copied[:] = part
        return copied

    def _like(self, array: NDArray[Any], K: int) -> NDArray[Any]:
        """Return memory for K rows of an array."""
        shape = K, *array.shape[1:]
        size = math.prod(shape) * array.itemsize
        if self._used + size > len(self._block):  # copies in the old block keep it alive
            self._block, self._used = np.empty(2 * len(self._block) + size, np.uint8), 0
        place = self._block[self._used : self._used + size]
        self._used += -(-size // ALIGNED) * ALIGNED
        return place.view(array.dtype).reshape(shape)


def raised(_: int, error: Exception) -> None:
    """Raise the error: there are no lanes to stop."""
    raise error


def saved(arrays: Iterable[NDArray[Any]], members: Times, buffer: CopyBuffer) -> Restore:
    """Copy the rows of the given valves; the result writes the copies back."""
    rows, arrays = rows_of(members), tuple(arrays)
    copies = buffer.copies(arrays, rows)

    def restore() -> None:
        for array, copy in zip(arrays, copies, strict=True):
            array[rows] = copy

    return restore


def rows_of(members: Times) -> slice | Times:
    """Return the rows of the given valves: a slice, which copies faster, if they are adjacent."""
    first = int(members[0]) if len(members) else 0
    adjacent = len(members) < 2 or bool((members[1:] - members[:-1] == 1).all())
    return slice(first, first + len(members)) if adjacent else members


def all_of(restores: Sequence[Restore]) -> Restore:
    """Return one function that calls all of them."""

    def restore() -> None:
        for one in restores:
            one()

    return restore
