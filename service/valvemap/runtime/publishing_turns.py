"""Whose results are published next, how much time may go into it, and whether that is enough."""

from collections.abc import Iterable
from itertools import islice
from typing import Final

VALVES_AT_ONCE: Final = 64  # 20 ms: of fewer each costs more
SOON_S, SOON = 0.7, 0.35  # s, and share of `stale_after_s`: results that wait longer get more time
HURRY: Final = 0.5  # share of the time then, unless samples wait, too
CALM_S, CALM = 0.5, 0.1  # s, and share of the time while none of many valves has waited so long
LATE: Final = 0.95  # of `stale_after_s`: results that have waited for so long may get old, shown
ON_TIME: Final = 0.85  # of it: once they wait no longer, they do not


class PublishingTurns:
    """Valves whose results are to be published, those that have waited longest first.

    Parameters
    ----------
    share
        Most of the time that goes into publishing as long as there is more to publish than that.
    stale_after_s
        Results that are shown for longer than that may not be called good.

    Attributes
    ----------
    late
        Publishing does not keep up: what is published now is old before it is replaced.
    round_s
        So long those waited that were published last: as long, about, they are shown.

    Examples
    --------
    >>> turns = PublishingTurns(share=0.25, stale_after_s=2.0)
    >>> turns.add([7, 3], now=0.0)
    >>> turns.add([3], now=1.0)
    >>> turns.next(now=1.95), turns.late
    ([7, 3], True)
    """

    def __init__(self, share: float, stale_after_s: float) -> None:
        self.late = False
        self.round_s = 0.0
        self._share = share
        self._stale_after_s = stale_after_s
        self._soon_s = min(SOON_S, SOON * stale_after_s)
        self._since: dict[int, float] = {}  # by valve, the oldest first
        self._doubted: set[int] = set()  # published while late
        self._due = 0.0

    def __len__(self) -> int:
        return len(self._since)

    def add(self, valves: Iterable[int], now: float) -> None:
        """These valves have new results; who waits already keeps its place."""
        for valve in valves:
            self._since.setdefault(valve, now)

    def are_due(self, now: float) -> bool:
        """Whether there is something to publish, and time for it."""
        return bool(self._since) and now >= self._due

    def next(self, now: float) -> list[int]:
        """Take the valves that are published now; who was doubted in vain comes again."""
        some = list(islice(self._since, VALVES_AT_ONCE))
        waited = now - self._since[some[0]] if some else 0.0
        self.round_s = waited
        self.late = waited > self._stale_after_s * (ON_TIME if self.late else LATE)
        for valve in some:
            del self._since[valve]
        doubted = self._doubted.difference(some)
        self._doubted = doubted.union(some) if self.late else set()
        if not self.late:
            self.add(doubted, now)
        elif not self._since:  # nothing waits any more
            self.add(self._doubted, now)
        return some

    def pause(self, began: float, now: float, *, samples_wait: bool) -> None:
        """Rest after publishing from ``began`` on: samples that come in go first."""
        share = self._share_of_time(now, samples_wait=samples_wait)
        self._due = now + (now - began) * (1.0 / share - 1.0)

    def _share_of_time(self, now: float, *, samples_wait: bool) -> float:
        waited = now - next(iter(self._since.values()), now)
        if waited > self._soon_s and not samples_wait:
            return max(self._share, HURRY)
        if len(self._since) > VALVES_AT_ONCE and waited < min(CALM_S, self._soon_s):
            return min(self._share, CALM)
        return self._share
