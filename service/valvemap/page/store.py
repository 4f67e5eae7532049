"""The newest value of everything that is looked at, and who has seen which of them."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Entry:
    """One value: number, text or nested list; its StatusCode, source time (UTC ns), revision."""

    value: Any
    code: int
    t: int
    revision: int


class Store:
    """Newest values by valve (its number) and name; each change gets the next revision.

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
        """Take a value in; nothing happens if it is the one that is there."""
        entries = self._valves.setdefault(valve, {})
        old = entries.get(name)
        if old is not None and old.code == code and old.t == t and _same(old.value, value):
            return
        self.revision += 1
        entries.pop(name, None)  # the newest stand last
        entries[name] = Entry(value, code, t, self.revision)

    def get(self, valve: int, name: str) -> Entry | None:
        """Newest value of one variable."""
        return self._valves.get(valve, {}).get(name)

    def newer(self, valve: int, revision: int) -> Iterator[tuple[str, Entry]]:
        """What has changed of a valve since ``revision``, the newest first."""
        for name, entry in reversed(self._valves.get(valve, {}).items()):
            if entry.revision <= revision:
                return
            yield name, entry

    def clear(self) -> None:
        """Forget all values: their server is another one."""
        self._valves.clear()
        self.revision += 1


def _same(a: Any, b: Any) -> bool:  # noqa: ANN401 - as read
    return bool(a == b or (a != a and b != b))  # noqa: PLR0124 - NaN
