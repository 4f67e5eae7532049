"""Successive samples of the variables of a block, as arrays."""

from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

Values = NDArray[Any]
Bools = NDArray[np.bool_]
Codes = NDArray[np.uint32]
Ticks = NDArray[np.int64]
Columns = NDArray[np.intp]


@dataclass(frozen=True)
class Batch:
    """k successive samples of n variables.

    ``values`` (k, n, w) with w elements of each variable's value; ``codes`` (k, n) StatusCodes;
    ``has`` (k, n), False where a sample has no value; ``source`` (k, n) in 100 ns since 1601;
    ``present`` (k, n), False where there is no sample, or None if all are present; ``server`` one
    time for all. ``columns`` (n,), in any order and each once, are the columns of the block that
    are written; None: all columns.
    """

    values: Values
    codes: Codes
    has: Bools
    source: Ticks
    server: int
    present: Bools | None
    columns: Columns | None = None

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, rows: slice) -> Self:
        return type(self)(
            self.values[rows],
            self.codes[rows],
            self.has[rows],
            self.source[rows],
            self.server,
            None if self.present is None else self.present[rows],
            self.columns,
        )

    def of(self, which: Columns) -> Self:
        """Return the samples of the given columns of the batch."""
        return type(self)(
            self.values[:, which],
            self.codes[:, which],
            self.has[:, which],
            self.source[:, which],
            self.server,
            None if self.present is None else self.present[:, which],
            None if self.columns is None else self.columns[which],
        )


class Watcher(Protocol):
    """Receives all batches written to a block."""

    def take_in(self, batch: Batch, moment: int) -> None:
        """Process the samples of a batch; ``moment`` is that of the first."""
