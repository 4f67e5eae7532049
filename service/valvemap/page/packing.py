"""Packs the new values of a valve once for all viewers with the same revision."""

from collections.abc import Iterator, Sequence

from valvemap.page.messages import pack_matrix, pack_numbers, pack_text
from valvemap.page.store import Store

_NAMES_AT_MOST = 60_000  # names are sent as u2


class Packing:
    """Numbers the names and caches packed messages until the store changes."""

    def __init__(self) -> None:
        self._names: dict[str, int] = {}
        self._packed: dict[tuple[int, int, int], tuple[str | bytes, ...]] = {}
        self._revision = 0

    @property
    def names(self) -> int:
        """Number of names."""
        return len(self._names)

    def values(
        self, store: Store, valve: int, since: int, names_seen: int
    ) -> Sequence[str | bytes]:
        """Return messages with the values of a valve newer than a revision, and with new names."""
        if store.revision != self._revision:
            self._packed.clear()
            self._revision = store.revision
        key = valve, since, names_seen
        if key not in self._packed:
            self._packed[key] = tuple(self._pack(store, *key))
        return self._packed[key]

    def _pack(self, store: Store, valve: int, since: int, names_seen: int) -> Iterator[str | bytes]:
        numbers, texts, matrices = [], {}, []
        for name, entry in store.newer(valve, since):
            value = entry.value
            if isinstance(value, bool | int | float):
                numbers.append((self._name(name), float(value), entry.code, entry.t))
            elif _is_text(value):
                texts[name] = value
            elif isinstance(value, list) and value:
                matrices.append(pack_matrix(valve, self._name(name), value, entry.t))
            elif value is None:
                numbers.append((self._name(name), float("nan"), entry.code, entry.t))
        if len(self._names) > names_seen:
            yield pack_text({"names": list(self._names)[names_seen:], "from": names_seen})
        if numbers:
            yield pack_numbers(valve, numbers)
        if texts:
            yield pack_text({"valve": valve, "texts": texts})
        yield from matrices

    def _name(self, name: str) -> int:
        if len(self._names) < _NAMES_AT_MOST:
            return self._names.setdefault(name, len(self._names))
        return self._names.get(name, 0)


def _is_text(value: object) -> bool:
    if isinstance(value, list):
        return bool(value) and all(isinstance(element, str) for element in value)
    return isinstance(value, str)
