"""Rows of a piece in order of time, and their comparison with stored ones."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Flags, Floats, Times
from valvemap.pipeline.store_ports import Piece


@dataclass(frozen=True)
class Rows:
    """Rows of a series with strictly increasing times (n,), UTC ns; codes and columns (n,)."""

    series: str
    t: Times
    codes: NDArray[np.uint32]
    columns: Mapping[str, Floats]

    def __getitem__(self, chosen: Flags) -> "Rows":
        columns = {name: values[chosen] for name, values in self.columns.items()}
        return Rows(self.series, self.t[chosen], self.codes[chosen], columns)

    def differs(self, stored: Mapping[str, NDArray[Any]], place: NDArray[Any]) -> Flags:
        """Return which rows (n,) differ from the stored rows at ``place`` (n,), bit by bit."""
        found = np.zeros(len(self.t), np.bool_)
        for name, values in self.columns.items():
            if name in stored:
                there = np.ascontiguousarray(stored[name][place])
                found |= there.view(np.int64) != np.ascontiguousarray(values).view(np.int64)
        return found


def by_time(piece: Piece) -> Rows:
    """Return the rows of a piece by time, the first of each time.

    >>> good = np.zeros(3, np.uint32)
    >>> by_time(Piece("V1.Signals", np.array([7, 5, 7]), good, {"Q": np.arange(3.0)})).columns
    {'Q': array([1., 0.])}
    """
    t, first = np.unique(piece.t, return_index=True)
    columns = {name: np.asarray(values[first]) for name, values in piece.columns.items()}
    return Rows(piece.series, t, piece.codes[first], columns)
