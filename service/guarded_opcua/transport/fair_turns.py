"""Fair scheduling of requests between connections.

Start-time fair queueing (Goyal, Vin, Cheng 1996) with two priority classes. Each connection earns
credit, a share of the server's processor time. It is modest while it has credit and its requests
are cheap; a modest connection is served as soon as the running turn ends. Otherwise it is in
excess: the connections in excess are served fairly among each other, and, while any modest
connection is present, with pauses in between, so that a modest request usually finds an idle
server. Cost is processor time, so that time in which the process does not run is charged to no
connection.
"""

import asyncio
import heapq
import itertools
from dataclasses import dataclass

from guarded_opcua.clock import Clock, Timer

_SHARE = 0.1  # of the server's processor time; credit that a connection earns
_SAVINGS_S = 0.2  # s; maximum credit
_LITTLE_S = 0.001  # s; maximum mean cost of a turn of a modest connection
_NEWEST = 0.3  # weight of the last turn in this exponential mean
_PAUSE = 3.0  # idle time after a request in excess, in units of its cost
_LONGEST_PAUSE_S = 0.1
_MEMORY_S = 1.0  # s; a modest connection is present for this time after its last request


@dataclass
class Cost:
    """Credit and cost of one connection, s.

    ``credit`` starts at zero: a new connection has earned none.
    """

    finished: float = 0.0
    credit: float = 0.0
    mean: float = 0.0
    earned_until: float = 0.0

    def earn(self, now: float) -> None:
        """Add the credit earned since the last call."""
        self.credit = min(_SAVINGS_S, self.credit + _SHARE * (now - self.earned_until))
        self.earned_until = now

    def spend(self, cost: float) -> None:
        """Subtract a cost incurred outside of the connection's turns."""
        self.finished += cost
        self.credit -= cost

    def charge(self, cost: float) -> None:
        """Subtract the cost of a turn, and update the mean cost."""
        self.spend(cost)
        self.mean += _NEWEST * (cost - self.mean)

    @property
    def in_excess(self) -> bool:
        """Whether the credit is used up or the mean cost of a turn is high."""
        return self.credit <= 0.0 or self.mean > _LITTLE_S


_Waiting = tuple[float, int, asyncio.Future[None]]


class FairTurns:
    """Schedules requests; one runs at a time."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._now = 0.0
        self._busy = False
        self._order = itertools.count()
        self._modest: list[_Waiting] = []
        self._in_excess: list[_Waiting] = []
        self._began = self._since = 0.0
        self._excess_runs = False
        self._excess_from = 0.0
        self._modest_seen = -_MEMORY_S
        self._timer: Timer | None = None

    async def take(self, account: Cost) -> None:
        """Wait for a turn."""
        now = self._clock.monotonic()
        account.earn(now)
        in_excess = account.in_excess
        if not in_excess:
            self._modest_seen = now
        start = max(self._now, account.finished)
        if self._busy or (in_excess and now < self._excess_from):
            turn = asyncio.get_running_loop().create_future()
            queue = self._in_excess if in_excess else self._modest
            heapq.heappush(queue, (start, next(self._order), turn))
            if not self._busy:
                self._next()
            try:
                await turn
            except asyncio.CancelledError:
                if turn.done() and not turn.cancelled():
                    self._next()
                raise
        self._busy = True
        self._excess_runs = in_excess
        self._now = max(self._now, start)
        account.finished = start
        self._began = self._clock.monotonic()
        self._since = self._clock.processor()

    def give(self, account: Cost) -> None:
        """End a turn and charge its cost."""
        now = self._clock.monotonic()
        cost = self._clock.processor() - self._since
        account.charge(cost)
        if self._excess_runs and now - self._modest_seen < _MEMORY_S:
            self._excess_from = now + min(_PAUSE * cost, _LONGEST_PAUSE_S)
        self._next()

    def costs_more_than(self, limit_s: float) -> bool:
        """Return whether the running turn costs more; reads the processor clock only if needed."""
        return (
            self._clock.monotonic() - self._began > limit_s
            and self._clock.processor() - self._since > limit_s
        )

    def _next(self) -> None:
        """Wake the next waiting request, which then holds the turn."""
        self._busy = False
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._wake(self._modest) or not self._in_excess:
            return
        pause = self._excess_from - self._clock.monotonic()
        if pause <= 0.0:
            self._wake(self._in_excess)
        else:
            self._timer = self._clock.call_at(self._excess_from, self._resume)

    def _resume(self) -> None:
        self._timer = None
        if not self._busy:
            self._next()

    def _wake(self, queue: list[_Waiting]) -> bool:
        while queue:
            _, _, turn = heapq.heappop(queue)
            if not turn.cancelled():
                self._busy = True
                turn.set_result(None)
                return True
        return False
