"""The buffer of received changes, and the watchdog for a silent server."""

import asyncio

from valvemap.clock import Clock
from valvemap.errors import SourceError, SourceLost
from valvemap.opcua_source.received import Part

LOST_KEEP_ALIVES = 3
_STALL_S = 1.0  # a wait longer than its timeout by this: our process was stalled


class ChangeBuffer:
    """The parts of one subscription between its publish responses and the caller of `receive`.

    The buffer is bounded: while it is full, `wait_for_room` waits. No publish requests are sent
    then, and the server queues its notifications.

    Parameters
    ----------
    url
        Endpoint of the server, for messages.
    limit
        Number of changes at which the buffer is full.
    silence_s
        Time without a response after which the connection is lost, s.
    clock
        Clock.
    """

    def __init__(self, url: str, limit: int, silence_s: float, clock: Clock) -> None:
        self._url, self._limit, self._silence_s, self._clock = url, limit, silence_s, clock
        self._heard_at = clock.monotonic()
        self._parts: list[Part] = []
        self._changes = 0
        self._arrived = asyncio.Event()
        self._room = asyncio.Event()
        self._room.set()
        self._failure: SourceError | None = None

    @property
    def is_full(self) -> bool:
        """Whether publish requests are withheld."""
        return not self._room.is_set()

    def note_response(self) -> None:
        """Note that the server has answered."""
        self._heard_at = self._clock.monotonic()

    def add(self, part: Part) -> None:
        """Add the changes of one message."""
        self._parts.append(part)
        self._changes += len(part.changes)
        if self._changes >= self._limit:
            self._room.clear()
        self._arrived.set()

    def fail(self, error: SourceError) -> None:
        """Note a failure, which `receive` raises once the buffer is empty; the first one counts."""
        self._failure = self._failure or error
        self._arrived.set()

    async def wait_for_room(self) -> None:
        """Wait while the buffer is full."""
        await self._room.wait()

    def take_rest(self) -> tuple[Part, ...]:
        """Empty the buffer, without more room; return its parts."""
        parts, self._parts = self._parts, []
        self._changes = 0
        return tuple(parts)

    async def receive(self) -> list[Part]:
        """Wait for changes and return all.

        Raises
        ------
        SourceError
            the failure, when the buffer is empty.
        SourceLost
            if the server is silent for too long.
        """
        listening = self._clock.monotonic()  # silence before this call does not count
        while not self._parts:
            if self._failure is not None:
                raise self._failure
            now = self._clock.monotonic()
            patience = max(self._heard_at, listening) + self._silence_s - now
            if patience <= 0.0:
                raise SourceLost(
                    f"{self._url}: silent for {self._silence_s:.1f} s, "
                    f"{LOST_KEEP_ALIVES} keep-alives are missing"
                )
            try:
                async with asyncio.timeout(patience):
                    await self._arrived.wait()
            except TimeoutError:
                if self._clock.monotonic() - now > patience + _STALL_S:
                    listening = self._clock.monotonic()
                continue
            self._arrived.clear()
        parts = list(self.take_rest())
        if not self._room.is_set():
            self.note_response()  # no publish requests: not the server's silence
            self._room.set()
        return parts
