"""Data changes as they come off the wire, decoded into arrays."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import field_names


@dataclass(frozen=True)
class DataChanges:
    """N data changes in the order of their arrival, all arrays of shape (N,).

    Attributes
    ----------
    item : int32
        ``valve * PER_VALVE + signal``, see :class:`~valvemap.vocabulary.signals.Signal`.
    value : float64
        The value; NaN if it is not a number.
    status : uint32
        OPC UA StatusCode as sent (Good = 0; severity in the top two bits; InfoBits kept).
    source_time : int64
        SourceTimestamp, UTC ns.
    """

    item: NDArray[np.int32]
    value: NDArray[np.float64]
    status: NDArray[np.uint32]
    source_time: NDArray[np.int64]

    @classmethod
    def empty(cls) -> Self:
        """Return a batch without changes."""
        return cls(
            item=np.empty(0, np.int32),
            value=np.empty(0, np.float64),
            status=np.empty(0, np.uint32),
            source_time=np.empty(0, np.int64),
        )

    @classmethod
    def concatenate(cls, parts: Sequence[Self]) -> Self:
        """Join batches, in their order."""
        if not parts:
            return cls.empty()
        columns = {name: [getattr(part, name) for part in parts] for name in field_names(cls)}
        return cls(**{name: np.concatenate(column) for name, column in columns.items()})

    def __len__(self) -> int:
        return len(self.item)

    def __getitem__(self, rows: slice | NDArray[np.bool_] | NDArray[np.intp]) -> Self:
        item, value, status = self.item[rows], self.value[rows], self.status[rows]
        return type(self)(item, value, status, self.source_time[rows])
