"""The port of historians, which store the values of variables."""

from collections.abc import Awaitable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

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
