"""The write states of a history's series: the last time, and blocks that are not joined."""

import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from valvemap.storage.history_blocks import SEALED, base_of
from valvemap.storage.history_cells import width_of

BLOCK: Final = 4_096  # rows of a sealed block: 41 s at 100 Hz, some 8 kB per column
CELLS: Final = 1_024  # of a large block of a tier: 2.8 h of 10 s, 3.6 days of 5 min
_SMALL = "SELECT id, rows FROM block WHERE series = ? AND rows < ? ORDER BY id"


@dataclass
class WriteState:
    """The write state of a series: its last time, and the rows of blocks that are not joined."""

    last: int = -(2**63)
    small: dict[int, int] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        """Number of rows that are not joined."""
        return sum(self.small.values())

    def start_anew(self) -> dict[int, int]:
        """Return the blocks to be joined, and drop them from the list."""
        small, self.small = self.small, {}
        return small


def series_of_file(
    connection: sqlite3.Connection, numbers: Mapping[str, int]
) -> dict[str, WriteState]:
    """Return the write state of every series in the file, by the name of its loose blocks."""
    names = {number: name for name, number in numbers.items()}
    found: dict[str, WriteState] = {}
    last = "SELECT series, max(last) FROM block GROUP BY series"
    for number, newest in connection.execute(last).fetchall():
        name = names[number]
        series = found.setdefault(base_of(name), WriteState())
        series.last = max(series.last, newest)
        if not name.endswith(SEALED):
            full = CELLS if width_of(name) else BLOCK
            series.small = dict(connection.execute(_SMALL, (number, full)).fetchall())
    return found
