"""Times of OPC UA (100 ns since 1601, picoseconds) as UTC ns (Part 6, 5.2.2.5 and 5.2.2.17)."""

EPOCH_TICKS = 116_444_736_000_000_000
"""1970-01-01 as an OPC UA DateTime: units of 100 ns since 1601-01-01."""

# limits of int64 ns, picoseconds included: one tick less than 2**63 ns, years 1677 to 2262
_MOST_TICKS = (2**63 - 1) // 100 - 1
MAX_TICKS = EPOCH_TICKS + _MOST_TICKS
MIN_TICKS = EPOCH_TICKS - _MOST_TICKS
MOST_PICOSECONDS = 9_999  # units of 10 ps; larger values are read as this one (Part 6, 5.2.2.17)


def ns_from_ticks(ticks: int, picoseconds: int = 0) -> int:
    """UTC ns of an OPC UA DateTime (100 ns since 1601) and its picoseconds (units of 10 ps).

    Exact; times outside int64 are clipped to the earliest or latest representable time.

    >>> ns_from_ticks(EPOCH_TICKS + 1), ns_from_ticks(EPOCH_TICKS, 1_234)
    (100, 12)
    """
    whole = min(max(ticks, MIN_TICKS), MAX_TICKS) - EPOCH_TICKS
    return whole * 100 + min(picoseconds, MOST_PICOSECONDS) // 100


def ticks_from_ns(ns: int) -> int:
    """OPC UA DateTime (100 ns since 1601) of UTC ns, rounded down.

    >>> ticks_from_ns(199) - EPOCH_TICKS
    1
    """
    return ns // 100 + EPOCH_TICKS
