"""Order and rate of publication: which valves are next, and whether publishing keeps up."""

from collections.abc import Iterable
from itertools import islice
from typing import Final

VALVES_AT_ONCE: Final = 64  # valves per call: 20 ms; smaller calls cost more per valve
SOON_S, SOON = 0.7, 0.35  # s, and share of `stale_after_s`; a longer wait raises the share of time
HURRY: Final = 0.5  # share of the time after such a wait, unless samples wait
CALM_S, CALM = 0.5, 0.1  # s, and share of the time while many valves wait for less than this
LATE: Final = 0.95  # of `stale_after_s`; a longer wait sets `late`: results may be stale when shown
ON_TIME: Final = 0.85  # of `stale_after_s`; a shorter wait clears `late`


class PublishingTurns:
    """A queue of valves with results to publish, longest wait first.

    Parameters
    ----------
    share
        Largest share of the time spent on publishing while results wait.
    stale_after_s
        Results shown for longer than this are not Good.

    Attributes
    ----------
    late
        Publishing does not keep up: results are stale before they are replaced.
    round_s
        Wait of the valves published last, s; about the time that their results are shown.

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
        """Queue valves with new results; a valve already queued keeps its place."""
        for valve in valves:
            self._since.setdefault(valve, now)

    def are_due(self, now: float) -> bool:
        """Whether valves are queued and the pause after the last publication is over."""
        return bool(self._since) and now >= self._due

    def next(self, now: float) -> list[int]:
        """Dequeue the valves to publish now; valves published while late are queued again later."""
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
        elif not self._since:  # the queue is empty
            self.add(self._doubted, now)
        return some

    def pause(self, began: float, now: float, *, samples_wait: bool) -> None:
        """Pause after a publication that began at ``began``: incoming samples have priority.

        A stall of the process in a publication does not prolong the pause.
        """
        share = self._share_of_time(now, samples_wait=samples_wait)
        self._due = now + min((now - began) * (1.0 / share - 1.0), self._soon_s)

    def _share_of_time(self, now: float, *, samples_wait: bool) -> float:
        waited = now - next(iter(self._since.values()), now)
        if waited > self._soon_s and not samples_wait:
            return max(self._share, HURRY)
        if len(self._since) > VALVES_AT_ONCE and waited < min(CALM_S, self._soon_s):
            return min(self._share, CALM)
        return self._share
