"""Queue of password checks: one at a time, round-robin between addresses."""

import asyncio
from collections import OrderedDict, deque
from dataclasses import dataclass

from guarded_opcua.clock import Clock
from guarded_opcua.security.accounts import Role
from guarded_opcua.security.users import UserStore

_PAUSE_S = 0.1  # s; delay of unknown users after a wrong password, limits the load of guessing
_MOST_WAITING = 5  # queued checks of one address; further ones are refused unhashed


@dataclass(frozen=True)
class _Guess:
    name: str
    password: str
    origin: str
    answer: asyncio.Future[Role | None]


class LoginQueue:
    """Hashes passwords sequentially in a thread: each takes 16 MB and about 40 ms.

    Users who have logged in from the same address before have priority. The others are served
    round-robin by address, so that guessing delays only the guessing address. An address may queue
    a few checks; further ones are refused unhashed.
    """

    def __init__(self, users: UserStore, clock: Clock) -> None:
        self.refused_unhashed = 0
        self._users = users
        self._clock = clock
        self._known: deque[_Guess] = deque()
        self._strangers: OrderedDict[str, deque[_Guess]] = OrderedDict()
        self._strangers_from = 0.0
        self._worker: asyncio.Task[None] | None = None
        self._more = asyncio.Event()

    async def authenticate(self, name: str, password: str, origin: str) -> Role | None:
        """Queue the check of a password; return the role, or None if it is refused."""
        answer: asyncio.Future[Role | None] = asyncio.get_running_loop().create_future()
        guess = _Guess(name, password, origin, answer)
        if self._users.locked(name, origin):
            await self._refuse()
            return None
        if self._users.knows(name, origin):
            waiting = self._known
        else:
            waiting = self._strangers.setdefault(origin, deque())
        if sum(other.origin == origin for other in waiting) >= _MOST_WAITING:
            await self._refuse()
            return None
        waiting.append(guess)
        self._more.set()
        if self._worker is None or self._worker.done():
            self._worker = asyncio.create_task(self._work())
        return await answer

    async def _refuse(self) -> None:
        """Count a refusal and wait as long as a check takes."""
        self.refused_unhashed += 1
        await self._clock.sleep(_PAUSE_S)

    async def _work(self) -> None:
        while self._known or self._strangers:
            guess = self._next()
            if guess is None:
                await self._wait_for_strangers()
                continue
            if guess.answer.done():  # the connection was lost
                continue
            role = None
            if not self._users.locked(guess.name, guess.origin):
                role = await asyncio.to_thread(
                    self._users.authenticate, guess.name, guess.password, guess.origin
                )
            if role is None:
                self._strangers_from = self._clock.monotonic() + _PAUSE_S
            if not guess.answer.done():
                guess.answer.set_result(role)

    def _next(self) -> _Guess | None:
        if self._known:
            return self._known.popleft()
        if self._clock.monotonic() < self._strangers_from:
            return None
        origin, waiting = self._strangers.popitem(last=False)
        guess = waiting.popleft()
        if waiting:
            self._strangers[origin] = waiting  # at the end of the round
        return guess

    async def _wait_for_strangers(self) -> None:
        """Wait until the pause of unknown users ends or a request arrives."""
        self._more.clear()
        timer = self._clock.call_at(self._strangers_from, self._more.set)
        try:
            await self._more.wait()
        finally:
            timer.cancel()
