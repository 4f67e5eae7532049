"""The rejected messages of a site, as the quantity and the reason of an alarm. Pure.

Workers and results servers publish each rejected message as a dead letter. A results server reads
the dead letters of its site's groups, and those of groups that the catalogue does not have.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from valvemap.foreign_text import printable

_MOST_NAME: Final = 40  # characters of a group's name in the alarm's text
_UNKNOWN: Final = "the dead letter names no reason"


@dataclass(frozen=True)
class Rejection:
    """One rejected message.

    Attributes
    ----------
    group
        Key of the message.
    reason
        Why it was rejected; printable.
    t
        Time of the dead letter, UTC ns; 0: now.
    topic
        The message's topic; empty: unknown.
    """

    group: str
    reason: str
    t: int = 0
    topic: str = ""

    @classmethod
    def of(cls, key: bytes | None, why: str, t: int = 0, topic: str = "") -> "Rejection":
        """Return the rejection of a message, with bounded, printable text."""
        group = printable((key or b"").decode("utf-8", "replace"), _MOST_NAME)
        return cls(group, printable(why), t, topic)

    @classmethod
    def from_headers(
        cls, key: bytes | None, headers: Iterable[tuple[str, bytes | None]] | None, t: int
    ) -> "Rejection":
        """Decode the headers of a dead letter; they may be anything.

        >>> Rejection.from_headers(b"north.0", [("reason", b"not JSON"), ("size", b"8")], 5)
        Rejection(group='north.0', reason='not JSON', t=5, topic='')
        """
        said = {name: (value or b"").decode("utf-8", "replace") for name, value in headers or ()}
        return cls.of(key, said.get("reason") or _UNKNOWN, t, said.get("topic", ""))


class Rejections:
    """Counts rejected messages until none came for ``quiet_s``.

    Parameters
    ----------
    quiet_s
        Time without a rejected message, after which the count is 0 again.

    Examples
    --------
    >>> rejections = Rejections(quiet_s=600.0)
    >>> rejections.note([Rejection("north.0", "not JSON")], now=5.0, utc=0)
    >>> rejections.count(now=600.0), rejections.reason
    (1, 'north.0: not JSON')
    >>> rejections.count(now=605.0)
    0
    """

    def __init__(self, quiet_s: float) -> None:
        self._quiet_s = quiet_s
        self._count = 0
        self._newest = -float("inf")  # monotonic, s
        self.reason = ""

    def note(self, found: Sequence[Rejection], now: float, utc: int) -> None:
        """Add rejected messages; ``now`` is monotonic, s, and ``utc`` the same moment, UTC ns."""
        for one in found:
            age_s = max((utc - one.t) * 1e-9, 0.0) if one.t else 0.0
            if age_s >= self._quiet_s:
                continue
            self._count = self.count(now) + 1
            if now - age_s >= self._newest:
                self._newest = now - age_s
                self.reason = f"{one.group or 'no group'}: {one.reason}"

    def count(self, now: float) -> int:
        """Return the number of messages since the last quiet time; ``now`` is monotonic, s."""
        if now - self._newest >= self._quiet_s:
            self._count = 0
        return self._count
