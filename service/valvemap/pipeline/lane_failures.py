"""Bulkheads: an exception in one lane (valve and estimator) stops only that lane. Pure.

A step works on many valves in one call. If it raises, its writes are undone and it is repeated
valve by valve. The valve at which it raises keeps its previous state and stops; all others get
the same bits as from one call. A step that belongs to one estimator stops that
lane, one that belongs to the valve stops all of its lanes, until an operator resets one of them.
"""

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
    do: Callable[[NDArray[np.intp]], None],
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
    >>> isolate(np.arange(3), add, lambda own: saved([total], own), lambda m, e: print(m, e))
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


def _at(do: Callable[[NDArray[np.intp]], None], one: NDArray[np.intp], _: Any) -> None:  # noqa: ANN401
    do(one)


def isolate_last(
    members: Times,
    do: Callable[[NDArray[np.intp]], None],
    save: Callable[[Times], Restore],
    stop: Stop,
) -> None:
    """As `isolate` for one valve; for several, re-raise: the outer `isolate` finds the valve."""
    if len(members) == 1:
        isolate(members, do, save, stop)
    elif len(members):
        do(np.arange(len(members)))


def raised(_: int, error: Exception) -> None:
    """Raise the error: there are no lanes to stop."""
    raise error


def saved(arrays: Iterable[NDArray[Any]], members: Times) -> Restore:
    """Copy the rows of the given valves; the result writes the copies back."""
    copies = [(array, array[members]) for array in arrays]

    def restore() -> None:
        for array, copy in copies:
            array[members] = copy

    return restore


def all_of(restores: Sequence[Restore]) -> Restore:
    """Return one function that calls all of them."""

    def restore() -> None:
        for one in restores:
            one()

    return restore
