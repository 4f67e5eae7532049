"""Counters of wrong passwords by name and address, for the lock-out."""

from collections import OrderedDict
from dataclasses import dataclass, field

_ORIGINS = 1_000  # addresses stored per name; further ones are counted only by name


@dataclass
class _Count:
    number: int = 0
    last: float = 0.0

    def add(self, now: float, lock_seconds: float) -> None:
        self.number = 1 + self.since(now, lock_seconds)
        self.last = now

    def since(self, now: float, lock_seconds: float) -> int:
        return self.number if now - self.last < lock_seconds else 0


@dataclass
class _Name:
    from_anywhere: _Count = field(default_factory=_Count)
    origins: OrderedDict[str, _Count] = field(default_factory=OrderedDict)


class Failures:
    """Counts wrong passwords; a count is reset ``lock_seconds`` after its last failure.

    Parameters
    ----------
    names
        Maximum number of names; the least recently tried one is evicted.
    lock_seconds
        Time until a count is reset, s.

    Examples
    --------
    >>> failures = Failures(names=10, lock_seconds=300.0)
    >>> for origin in ("10.0.0.1", "10.0.0.1", "10.0.0.2"):
    ...     failures.add("anna", origin, now=0.0)
    >>> failures.of_origin("anna", "10.0.0.1", now=1.0), failures.of_name("anna", now=1.0)
    (2, 3)
    >>> failures.of_name("anna", now=301.0)
    0
    """

    def __init__(self, names: int, lock_seconds: float) -> None:
        self._most = names
        self._lock_seconds = lock_seconds
        self._names: OrderedDict[str, _Name] = OrderedDict()

    def add(self, name: str, origin: str, now: float) -> None:
        """Count a wrong password."""
        found = self._names.setdefault(name, _Name())
        self._names.move_to_end(name)
        if len(self._names) > self._most:
            self._names.popitem(last=False)
        found.from_anywhere.add(now, self._lock_seconds)
        found.origins.setdefault(origin, _Count()).add(now, self._lock_seconds)
        found.origins.move_to_end(origin)
        if len(found.origins) > _ORIGINS:
            found.origins.popitem(last=False)

    def forget(self, name: str, origin: str) -> None:
        """Reset the count of a name and address after a correct password."""
        if name in self._names:
            self._names[name].origins.pop(origin, None)

    def forget_name(self, name: str) -> None:
        """Reset all counts of a name."""
        self._names.pop(name, None)

    def of_origin(self, name: str, origin: str, now: float) -> int:
        """Return the count of one name from one address."""
        found = self._names.get(name)
        count = found.origins.get(origin) if found is not None else None
        return 0 if count is None else count.since(now, self._lock_seconds)

    def of_name(self, name: str, now: float) -> int:
        """Return the count of one name from all addresses."""
        found = self._names.get(name)
        return 0 if found is None else found.from_anywhere.since(now, self._lock_seconds)
