"""Queue of log-in attempts: one at a time, known users first, round robin over addresses."""

import asyncio
from collections import OrderedDict, deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from valvemap.errors import CommandRejected

_OF_ADDRESS, _IN_ALL = 5, 60  # log-ins that may wait, of one address and in total

_Waiting = deque[asyncio.Future[None]]


class Turns:
    """One turn at a time.

    Known users come first. The others take turns by address, so that an address that guesses
    passwords delays only itself.
    """

    def __init__(self) -> None:
        self._is_taken = False
        self._known: _Waiting = deque()
        self._strangers: OrderedDict[str, _Waiting] = OrderedDict()

    @asynccontextmanager
    async def turn(self, address: str, *, is_known: bool) -> AsyncIterator[None]:
        """Wait for a turn; it ends with the block.

        Raises
        ------
        CommandRejected
            if too many wait.
        """
        await self._wait(address, is_known=is_known)
        try:
            yield
        finally:
            self._is_taken = False
            self._pass_on()

    async def _wait(self, address: str, *, is_known: bool) -> None:
        waiting = self._known if is_known else self._strangers.get(address, deque())
        in_all = len(self._known) + sum(map(len, self._strangers.values()))
        if len(waiting) >= _OF_ADDRESS or in_all >= _IN_ALL:
            raise CommandRejected("too many log-ins wait: try again in some seconds")
        mine: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        waiting.append(mine)
        if not is_known:
            self._strangers[address] = waiting
        self._pass_on()
        try:
            await mine
        except asyncio.CancelledError:
            if mine.done() and not mine.cancelled():  # cancelled after the turn was given
                self._is_taken = False
                self._pass_on()
            raise

    def _pass_on(self) -> None:
        """Give the turn to the next waiter, if it is free."""
        while not self._is_taken and (self._known or self._strangers):
            turn = self._next()
            if not turn.done():
                self._is_taken = True
                turn.set_result(None)

    def _next(self) -> asyncio.Future[None]:
        if self._known:
            return self._known.popleft()
        address, waiting = self._strangers.popitem(last=False)
        turn = waiting.popleft()
        if waiting:
            self._strangers[address] = waiting  # behind the other addresses
        return turn
