"""Newest value of each variable, with revisions for incremental updates of the viewers."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from valvemap.clock import utc_ns
from valvemap.readings import Reading

_BAD_NODE_ID_UNKNOWN = 0x8034_0000


@dataclass(frozen=True, slots=True)
class Entry:
    """One value: number, text or nested list; its StatusCode, source time (UTC ns), revision."""

    value: Any
    code: int
    t: int
    revision: int


class Store:
    """Newest values by valve number and name; each change increments the revision.

    >>> store = Store()
    >>> store.put(0, "RLS.Residual", 0.5, 0, 0)
    >>> store.put(0, "RLS.Residual", 0.5, 0, 0)
    >>> [(name, entry.value) for name, entry in store.newer(0, 0)], store.revision
    ([('RLS.Residual', 0.5)], 1)
    """

    def __init__(self) -> None:
        self.revision = 0
        self._valves: dict[int, dict[str, Entry]] = {}

    def put(self, valve: int, name: str, value: Any, code: int, t: int) -> None:  # noqa: ANN401 - as read
        """Store a value; the revision stays if it is unchanged."""
        entries = self._valves.setdefault(valve, {})
        old = entries.get(name)
        if old is not None and old.code == code and old.t == t and _same(old.value, value):
            return
        self.revision += 1
        entries.pop(name, None)  # keep the newest last
        entries[name] = Entry(value, code, t, self.revision)

    def get(self, valve: int, name: str) -> Entry | None:
        """Newest value of one variable."""
        return self._valves.get(valve, {}).get(name)

    def newer(self, valve: int, revision: int) -> Iterator[tuple[str, Entry]]:
        """Yield the values of a valve changed since ``revision``, the newest first."""
        for name, entry in reversed(self._valves.get(valve, {}).items()):
            if entry.revision <= revision:
                return
            yield name, entry

    def clear(self) -> None:
        """Drop all values, after the set of valves has changed."""
        self._valves.clear()
        self.revision += 1


def store_readings(
    store: Store, number: int, names: Sequence[str], readings: Sequence[Reading]
) -> None:
    """Store the readings of variables that exist; a DateTime becomes ms since 1970."""
    for name, reading in zip(names, readings, strict=True):
        if reading.code != _BAD_NODE_ID_UNKNOWN:
            value = reading.value
            if isinstance(value, datetime):
                value = utc_ns(value) * 1e-6
            store.put(number, name, value, reading.code, reading.t)


def _same(a: Any, b: Any) -> bool:  # noqa: ANN401 - as read
    return bool(a == b or (a != a and b != b))  # noqa: PLR0124 - NaN
