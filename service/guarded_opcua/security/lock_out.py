"""Wrong passwords, counted by name and by where they came from."""

from collections import OrderedDict
from dataclasses import dataclass, field

_ORIGINS = 1_000  # remembered of one name; who comes from more is counted by name


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
    """Counts wrong passwords; so long after the last one they are forgotten.

    Parameters
    ----------
    names
        How many names are remembered; the one that was not tried for longest goes.
    lock_seconds
        How long a failure counts.

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
        """Forget what came from there: the right password has come."""
        if name in self._names:
            self._names[name].origins.pop(origin, None)

    def forget_name(self, name: str) -> None:
        """Forget all of a name."""
        self._names.pop(name, None)

    def of_origin(self, name: str, origin: str, now: float) -> int:
        """How many there were of one name from one address."""
        found = self._names.get(name)
        count = found.origins.get(origin) if found is not None else None
        return 0 if count is None else count.since(now, self._lock_seconds)

    def of_name(self, name: str, now: float) -> int:
        """How many there were of one name from anywhere."""
        found = self._names.get(name)
        return 0 if found is None else found.from_anywhere.since(now, self._lock_seconds)
