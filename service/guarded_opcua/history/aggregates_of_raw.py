"""Aggregates of the raw values in each interval, one row a function (Part 13, 5.4)."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from guarded_opcua.history.aggregate_kinds import CALCULATED, MULTI_VALUE, Aggregate
from guarded_opcua.history.line import NO_DATA, SUB_NORMAL
from guarded_opcua.history.raw_statistics import RawStatistics

_Floats = NDArray[np.float64]
_Times = NDArray[np.int64]
_Codes32 = NDArray[np.uint32]
Found = tuple[_Floats, _Codes32, _Times]  # values, statuses, times


@dataclass(frozen=True)
class OfRaw:
    """Statistics of n intervals; all arrays (n,).

    Attributes
    ----------
    raw
        Statistics of their values.
    starts
        Where they begin.
    doubtful
        Whether some of their values are not Good.
    partial
        The Partial bit.
    by_values
        The status by the shares of Good and Bad values.
    """

    raw: RawStatistics
    starts: _Times
    doubtful: NDArray[np.bool_]
    partial: _Times
    by_values: _Codes32


def _end(which: str, of: OfRaw) -> Found:
    """The first or last value, with its own time and status."""
    ends, there = of.raw.all, of.raw.all.n > 0
    codes = np.where(there, getattr(ends, f"{which}_code"), NO_DATA).astype(np.uint32)
    return getattr(ends, which), codes, np.where(there, getattr(ends, f"{which}_t"), of.starts)


def _extreme(which: str, of: OfRaw) -> Found:
    """The smallest or largest Good value, with its time."""
    there, again = of.raw.good.n > 0, getattr(of.raw, f"{which}_again")
    bits = np.where(again > 1, MULTI_VALUE, 0) | np.where(of.doubtful, SUB_NORMAL, 0) | of.partial
    codes = np.where(there, bits, NO_DATA).astype(np.uint32)
    values = np.where(there, getattr(of.raw, which), 0.0)
    return values, codes, np.where(there, getattr(of.raw, f"{which}_t"), of.starts)


def _difference(less: Callable[[RawStatistics], _Floats], of: OfRaw) -> Found:
    """A difference of two Good values."""
    there = of.raw.good.n > 0
    codes = np.where(of.doubtful, SUB_NORMAL, 0) | CALCULATED | of.partial
    with np.errstate(invalid="ignore"):  # inf - inf where there is no value
        values = np.where(there, less(of.raw), 0.0)
    return values, np.where(there, codes, NO_DATA).astype(np.uint32), of.starts


def _spread(power: float, fewer: int, of: OfRaw) -> Found:
    """A variance of the Good values, or its root; 0 of a single value."""
    variance = of.raw.square / np.maximum(of.raw.good.n - fewer, 1)
    return variance**power, of.by_values, of.starts


OF_RAW: Final[Mapping[Aggregate, Callable[[OfRaw], Found]]] = {
    Aggregate.START: partial(_end, "first"),
    Aggregate.END: partial(_end, "last"),
    Aggregate.MINIMUM_ACTUAL_TIME: partial(_extreme, "low"),
    Aggregate.MAXIMUM_ACTUAL_TIME: partial(_extreme, "high"),
    Aggregate.RANGE: partial(_difference, lambda raw: raw.high - raw.low),
    Aggregate.DELTA: partial(_difference, lambda raw: raw.good.last - raw.good.first),
    Aggregate.STANDARD_DEVIATION_SAMPLE: partial(_spread, 0.5, 1),
    Aggregate.STANDARD_DEVIATION_POPULATION: partial(_spread, 0.5, 0),
    Aggregate.VARIANCE_SAMPLE: partial(_spread, 1.0, 1),
    Aggregate.VARIANCE_POPULATION: partial(_spread, 1.0, 0),
}
