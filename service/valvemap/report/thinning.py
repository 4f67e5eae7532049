"""A stream of any length, thinned to what a picture can show."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Column = NDArray[Any]


class Thinned:
    """Keeps every k-th row of a stream; k doubles whenever more than ``limit`` rows are held.

    Which rows are kept does not depend on how the stream is cut into batches.

    >>> rows = Thinned(limit=4)
    >>> for start in range(0, 10, 2):
    ...     rows.add({"t": np.arange(start, start + 2)})
    >>> rows.columns["t"]
    array([0, 4, 8])
    """

    def __init__(self, limit: int = 20_000) -> None:
        self._limit = limit
        self._every = 1
        self._seen = 0
        self._held = 0
        self._parts: list[Mapping[str, Column]] = []

    def add(self, columns: Mapping[str, Column]) -> None:
        """Take rows; every column has as many (N, ...), and the same names each time."""
        n = len(next(iter(columns.values())))
        kept = {
            name: column[-self._seen % self._every :: self._every].copy()
            for name, column in columns.items()
        }
        self._seen += n
        self._held += len(next(iter(kept.values())))
        self._parts.append(kept)
        while self._held > self._limit:
            self._parts = [{name: column[::2].copy() for name, column in self.columns.items()}]
            self._every *= 2
            self._held = -(-self._held // 2)

    @property
    def columns(self) -> dict[str, Column]:
        """The rows that are kept; empty before the first ``add``."""
        if not self._parts:
            return {}
        return {
            name: np.concatenate([part[name] for part in self._parts]) for name in self._parts[0]
        }
