"""Ports to stores: checkpoints of states, and the history.

An adapter raises one of the typed errors of :mod:`valvemap.errors`; the caller retries.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Floats, Times
from valvemap.pipeline.alarm_results import AlarmChange


class KeptElsewhere(Protocol):
    """States that are saved beside the valves', in a separate file."""

    failures: int
    """Saves that failed."""

    refused: int
    """States that were not restored at the start."""

    def age_s(self, now: float) -> float:
        """Time since the last save, monotonic s; ∞: the file was lost."""


class CheckpointStore(Protocol):
    """Stores the newest state of every estimator over restarts."""

    def save(self, checkpoints: Sequence["Checkpoint"]) -> None:
        """Save all of them or none.

        Raises
        ------
        StorageError
            naming the file (disk full, read-only, locked).
        """

    def load(self, together: Sequence[Sequence[str]] = ()) -> Sequence["Checkpoint"]:
        """Return the newest checkpoint of each (valve, estimator).

        ``together`` are names of valves whose samples meet: if a state of one is damaged, those of
        the others are from the same earlier save.
        """

    def put_aside(
        self,
        aside: Sequence[tuple["Checkpoint", str]],
        moved: Mapping[tuple[str, str], tuple[str, str]],
    ) -> None:
        """Keep checkpoints that are not restored, each with its reason, and rename others.

        ``moved`` maps (valve, estimator) to its new name.

        Raises
        ------
        StorageError
            naming the file.
        """

    @property
    def size(self) -> int:
        """Size in bytes."""

    @property
    def damaged(self) -> Sequence[str]:
        """``<Valve>.<Estimator>`` whose newest state was damaged at `load`."""


@dataclass(frozen=True)
class Checkpoint:
    """One estimator's state as bytes, and the operator's settings.

    ``meaning`` is that of the valve's signals, see :class:`valvemap.pipeline.meaning.Meaning`;
    empty: unknown.
    """

    valve: str
    estimator: str
    key: str
    t: int
    state: bytes
    lam: float | None
    frozen: bool
    meaning: str = ""


@dataclass(frozen=True)
class Piece:
    """Successive rows of one series, for the history.

    Times ``t`` (n,) in UTC ns, OPC UA status ``codes`` (n,), and columns (n,) by name.
    """

    series: str
    t: Times
    codes: NDArray[np.uint32]
    columns: Mapping[str, Floats]


@dataclass(frozen=True)
class Past:
    """History of one column of a series: times (n,) in UTC ns, values (n,), status codes (n,)."""

    t: Times
    values: Floats
    codes: NDArray[np.uint32]

    def __getitem__(self, rows: slice) -> "Past":
        return Past(self.t[rows], self.values[rows], self.codes[rows])


@dataclass(frozen=True)
class PastCells:
    """One column of a series, summarised in cells of equal width; all arrays of shape (n,).

    Attributes
    ----------
    t
        Start of each cell, UTC ns, a multiple of the width; cells without rows are left out.
    rows, good, uncertain
        Number of rows, and of those with a Good and an Uncertain value; the others are Bad.
    low, high, total
        Minimum, maximum and sum of the Good values; ∞, −∞, 0 without one.
    marks
        Bits: 1, 2: minimum, maximum occur more than once; 4, 8: they are the first Good value, at
        the cell's start.
    extent
        First and last time of all rows of the series, UTC ns.
    """

    t: Times
    rows: Times
    good: Times
    uncertain: Times
    low: Floats
    high: Floats
    total: Floats
    marks: NDArray[np.uint8]
    extent: tuple[int, int]


class PastStore(Protocol):
    """Stores and returns the history of signals and results; from any thread, one at a time.

    Attributes
    ----------
    widths
        Widths of the cells of `cells`, ascending, ns.
    """

    widths: Sequence[int]

    @property
    def lost(self) -> int:
        """Rows lost by damage to the file, or because others of their time are stored."""

    def save(self, pieces: Iterable[Piece]) -> int:
        """Save all pieces or none; return the number of values skipped as stored already.

        Raises
        ------
        StorageError
            naming the file.
        """

    def forget(self) -> int:
        """Drop blocks that are too old or over the size limit; return their number."""

    def read(
        self,
        series: str,
        column: str,
        low: int,
        high: int,
        *,
        backwards: bool = False,
        skip: int = 0,
        most: int,
    ) -> Past:
        """Return rows from ``low`` to ``high`` (UTC ns, inclusive), without the first ``skip``."""

    def cells(self, series: str, column: str, low: int, high: int, width: int) -> PastCells | None:
        """Return the cells of a width (ns) that begin from ``low`` to before ``high``.

        None if there are none of that width, or while a file is repaired.
        """

    def note(self, changes: Sequence[AlarmChange]) -> None:
        """Save changes of alarms; a change that is stored already is skipped.

        Raises
        ------
        StorageError
            naming the file.
        """

    def changes(
        self,
        owner: str | None,
        low: int,
        high: int,
        *,
        backwards: bool = False,
        skip: int = 0,
        most: int,
    ) -> Sequence[AlarmChange]:
        """Return changes of an owner's alarms (None: all owners), see :meth:`read`."""

    def take_notes(self) -> Sequence[str]:
        """Return the messages about damage since the last call."""

    @property
    def size(self) -> int:
        """Size in bytes."""
