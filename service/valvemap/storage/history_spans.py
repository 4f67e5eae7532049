"""For how long a history has its rows and tiers, by age and by size."""

import sqlite3
from typing import Final, NamedTuple, Self

from valvemap.storage import alarm_changes, history_age
from valvemap.storage.history_blocks import SEALED, base_of
from valvemap.storage.history_cells import WIDTHS, width_of
from valvemap.storage.history_series import SeriesWriter

SIGNALS: Final = ".Signals"  # ends the names of series of measured values; others are results
LEAST_RESULTS: Final = 0.125  # of the size; results have at least this much of it, if they need it
LEAST_ROWS: Final = 0.5  # of the size; rows of signals and results have at least this much
_MORE: Final = 0.01  # of the size; dropped beyond the excess, so that not each minute has to search


class Spans(NamedTuple):
    """Ages at which something is dropped, s of open file."""

    signals_s: float
    results_s: float
    fine_s: float
    """The tier of 10 s."""
    coarse_s: float
    """The tier of 5 min."""

    @classmethod
    def of(cls, keep_s: float, results_s: float | None, trend_s: float | None) -> Self:
        """Return the spans; those that are None are ``keep_s``."""
        results = keep_s if results_s is None else min(results_s, keep_s)
        trend = keep_s if trend_s is None else max(trend_s, keep_s)
        return cls(keep_s, results, keep_s, trend)


class _Numbers(NamedTuple):
    """Numbers of series, by their content."""

    signals: list[int]
    results: list[int]
    fine: list[int]
    coarse: list[int]

    @classmethod
    def of(cls, rows: SeriesWriter) -> Self:
        found = cls([], [], [], [])
        for name, number in rows.names.items():
            if width := width_of(name):
                (found.fine if width == WIDTHS[0] else found.coarse).append(number)
            elif SEALED not in base_of(name):
                (found.signals if base_of(name).endswith(SIGNALS) else found.results).append(number)
        return found


def drop_aged(
    connection: sqlite3.Connection, rows: SeriesWriter, spans: Spans, now_s: float
) -> int:
    """Drop the blocks that are too old at a time of the file, s; return their number."""
    dropped = 0
    for span_s, numbers in zip(spans, _Numbers.of(rows), strict=True):
        if old := history_age.expired(connection, now_s - span_s):
            dropped += rows.drop(old.block, numbers)
    if oldest := history_age.expired(connection, now_s - max(spans)):
        alarm_changes.forget(connection, oldest.change)
        history_age.forget_before(connection, oldest)
    return dropped


def drop_excess(rows: SeriesWriter, excess: int, most: int) -> int:
    """Drop the oldest blocks that together hold ``excess`` bytes; return their number.

    Rows of results are dropped first, then those of signals, then tiers; each as far as the least
    shares of the size allow.
    """
    signals, results, fine, coarse = _Numbers.of(rows)
    shares = (
        (results, round(LEAST_RESULTS * most)),
        (signals + results, round(LEAST_ROWS * most)),
        (fine, 0),
        (signals + results + coarse, 0),
    )
    return rows.drop_oldest(excess + round(_MORE * most), shares)


def raw_bytes(connection: sqlite3.Connection, rows: SeriesWriter) -> tuple[int, int]:
    """Return the number of the oldest block of signals, and the bytes that rows hold since then."""
    signals, results, _, _ = _Numbers.of(rows)
    listed = ", ".join(map(str, signals or [-1]))
    select = f"SELECT ifnull(min(id), 0) FROM block WHERE series IN ({listed})"  # noqa: S608
    (oldest,) = connection.execute(select).fetchone()
    select = (
        "SELECT ifnull(sum(length(data)), 0) FROM block JOIN part ON part.block = block.id "  # noqa: S608
        f"WHERE series IN ({', '.join(map(str, signals + results))})"
    )
    (held,) = connection.execute(select).fetchone()
    return int(oldest), int(held)
