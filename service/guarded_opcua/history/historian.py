"""The port of historians, which store the values of variables."""

from collections.abc import Awaitable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

EVER = -(2**63), 2**63 - 1
"""Range of all times, UTC ns."""


@dataclass(frozen=True)
class Span:
    """Source times from ``low`` to ``high`` (UTC ns, inclusive).

    ``backwards``: newest first.
    """

    low: int
    high: int
    backwards: bool = False

    @property
    def first(self) -> int:
        """First time in reading order."""
        return self.high if self.backwards else self.low

    def behind(self, skip: int, read: NDArray[np.int64]) -> tuple["Span", int]:
        """Return the remaining span after a partial read, and the number of its records to skip.

        ``read`` are the times of the records read, after the ``skip`` records that were skipped.
        """
        last = int(read[-1])
        seen = int(np.count_nonzero(read == last))
        skip = seen + (skip if last == self.first else 0)
        rest = replace(self, high=last) if self.backwards else replace(self, low=last)
        return rest, skip


@dataclass(frozen=True)
class Records:
    """N successive values of one variable, all arrays of shape (N,).

    Attributes
    ----------
    values
        Numbers of the variable's type; arbitrary if the status is Bad.
    codes : uint32
        StatusCodes; a Bad one has no value.
    source, server : int64
        Times of the source and of the server, UTC ns.
    """

    values: NDArray[Any]
    codes: NDArray[np.uint32]
    source: NDArray[np.int64]
    server: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.codes)

    def __getitem__(self, rows: slice) -> "Records":
        return Records(self.values[rows], self.codes[rows], self.source[rows], self.server[rows])


def joined(parts: Sequence[Records]) -> Records:
    """Concatenate records."""
    if len(parts) == 1:
        return parts[0]
    names = ("values", "codes", "source", "server")
    return Records(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


class Historian(Protocol):
    """Stores the values of variables.

    Calls are sequential, in the order of the requests. If an answer takes longer than a
    millisecond, return an awaitable, so that other requests are not delayed.
    """

    def raw(
        self, variable: ua.NodeId, span: Span, skip: int, most: int
    ) -> Records | Awaitable[Records]:
        """Return the raw values of a variable, as they were written.

        Parameters
        ----------
        variable
            A variable with this historian.
        span
            Source times and reading order; records with the same time keep the order of writing.
        skip
            Number of leading records to skip.
        most
            Maximum number of records to return.
        """


@dataclass(frozen=True)
class Cells:
    """One variable, summarised in cells of equal width; all arrays of shape (n,).

    Attributes
    ----------
    width
        ns; a cell begins at a multiple of it since 1970.
    t
        Start of each cell, UTC ns, ascending; cells without values are left out.
    values, good, uncertain
        Number of values, of the Good and of the Uncertain ones; the others are Bad.
    low, high, total
        Minimum, maximum and sum of the Good values; ∞, −∞, 0 without one.
    low_again, high_again
        Whether the minimum, the maximum occurs more than once.
    low_first, high_first
        Whether it is the first Good value, at the cell's start.
    extent
        First and last time of all values of the variable.
    """

    width: int
    t: NDArray[np.int64]
    values: NDArray[np.int64]
    good: NDArray[np.int64]
    uncertain: NDArray[np.int64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    total: NDArray[np.float64]
    low_again: NDArray[np.bool_]
    high_again: NDArray[np.bool_]
    low_first: NDArray[np.bool_]
    high_first: NDArray[np.bool_]
    extent: tuple[int, int]

    def __len__(self) -> int:
        return len(self.t)

    def between(self, low: int, high: int) -> "Cells":
        """Return the cells that begin from ``low`` to before ``high``."""
        rows = slice(*np.searchsorted(self.t, [low, high]).tolist())
        arrays = {
            field.name: getattr(self, field.name)[rows]
            for field in fields(self)
            if field.name not in {"width", "extent"}
        }
        return replace(self, **arrays)


@runtime_checkable
class Summarising(Protocol):
    """A historian that has its values summarised, too: aggregates need not read them all.

    Attributes
    ----------
    widths
        Widths of its cells, ascending, ns.
    """

    widths: Sequence[int]

    def cells(
        self, variable: ua.NodeId, low: int, high: int, width: int
    ) -> Awaitable["Cells | None"]:
        """Return the cells that begin from ``low`` to before ``high``, UTC ns; None: no cells.

        They may count values that `Historian.raw` does not return any more, but never fewer.
        """
