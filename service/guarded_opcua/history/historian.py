"""The port behind which somebody keeps what variables have been."""

from collections.abc import Awaitable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

EVER = -(2**63), 2**63 - 1
"""All times that there are, UTC ns."""


@dataclass(frozen=True)
class Span:
    """Source times from ``low`` to ``high`` (UTC ns, both belong to it).

    ``backwards``: the newest comes first.
    """

    low: int
    high: int
    backwards: bool = False

    @property
    def first(self) -> int:
        """Where it begins."""
        return self.high if self.backwards else self.low

    def behind(self, skip: int, read: NDArray[np.int64]) -> tuple["Span", int]:
        """Where it goes on once some of it is read, and how many records to leave out there.

        ``read`` are their times; ``skip`` were left out before these.
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
        Numbers of the variable's type; whatever where there is none.
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
    """Records one after the other."""
    if len(parts) == 1:
        return parts[0]
    names = ("values", "codes", "source", "server")
    return Records(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


class Historian(Protocol):
    """Keeps what variables have been.

    Calls come one after the other, in the order of the requests; an answer that takes longer than
    a millisecond is an awaitable, so that nobody else waits for it.
    """

    def raw(
        self, variable: ua.NodeId, span: Span, skip: int, most: int
    ) -> Records | Awaitable[Records]:
        """What a variable was, as it was written.

        Parameters
        ----------
        variable
            One of those it was registered for.
        span
            Times, and in which order; records of one time stay in the order they were written in.
        skip
            So many of these records are left out.
        most
            So many are returned at most.
        """
