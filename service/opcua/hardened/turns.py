"""Whose request is next: the connection that has cost the least so far.

Start-time fair queueing (Goyal, Vin, Cheng 1996): a connection that floods the server waits for
its own floods, while one that asks now and then is next at once.
"""

import asyncio
import heapq
import itertools
import time
from dataclasses import dataclass


@dataclass
class Account:
    """What one connection has cost, in s of the server's own virtual time."""

    finished: float = 0.0


class Turns:
    """Lets one request run at a time."""

    def __init__(self) -> None:
        self._now = 0.0
        self._busy = False
        self._order = itertools.count()
        self._waiting: list[tuple[float, int, asyncio.Future[None]]] = []
        self._since = 0.0

    async def take(self, account: Account) -> None:
        """Wait for a turn."""
        start = max(self._now, account.finished)
        if self._busy:
            turn = asyncio.get_running_loop().create_future()
            heapq.heappush(self._waiting, (start, next(self._order), turn))
            try:
                await turn
            except asyncio.CancelledError:
                if turn.done() and not turn.cancelled():
                    self._next()
                raise
        self._busy = True
        self._now = max(self._now, start)
        account.finished = start
        self._since = time.perf_counter()

    def give(self, account: Account) -> None:
        """End a turn; what it took is charged."""
        account.finished += time.perf_counter() - self._since
        self._next()

    @property
    def held_s(self) -> float:
        """How long the running turn has lasted."""
        return time.perf_counter() - self._since

    def _next(self) -> None:
        while self._waiting:
            _, _, turn = heapq.heappop(self._waiting)
            if not turn.cancelled():
                turn.set_result(None)
                return
        self._busy = False
