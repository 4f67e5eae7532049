"""What time a source has: read when we connect, and again now and then."""

import asyncio
from collections import deque
from datetime import datetime
from typing import NamedTuple

from asyncua import ua

from valvemap.clock import Clock, utc_ns
from valvemap.errors import SourceError
from valvemap.opcua_client.connection import Connection
from valvemap.opcua_client.requests import read_values

READ_EVERY_S = 10.0
_READINGS = 6  # that are remembered: so long a source may be too busy to say the right time
_CLOCKS_AGREE_S = 0.1  # closer together the source's clock gives no better age
_RENEWED_S = 1.0  # between two times that a server says


class Reading(NamedTuple):
    """By how much a source's time was ahead of ours, s, and how long it took to read it, s."""

    ahead_s: float
    took_s: float


class SourceClock:
    """By how much a source's clock is ahead of ours.

    What it says is never too late, and may be too early: by the way to us, by up to a second, as
    many servers renew it as seldom, and by more from one that is busy. So the reading that is most
    ahead counts, of those of the last minute.

    Parameters
    ----------
    clock
        Ours.

    Attributes
    ----------
    started
        When the server was started, UTC ns, as it said; 0 if it did not.

    Examples
    --------
    >>> from valvemap.clock import SystemClock
    >>> clock = SourceClock(SystemClock())
    >>> for ahead_s in (-4.0, -2.0, -2.5):
    ...     clock.note(Reading(ahead_s, took_s=0.01))
    >>> clock.ahead_s
    -2.0
    >>> clock.note(Reading(-0.9, took_s=0.01))
    >>> clock.ahead_s
    0.0
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._readings: deque[Reading] = deque(maxlen=_READINGS)
        self._following: asyncio.Task[None] | None = None
        self.started = 0

    @property
    def ahead_s(self) -> float:
        """By how much it is ahead of ours, s; 0 where both may be the same, or it does not say."""
        if not self._readings:
            return 0.0
        ahead_s, took_s = max(self._readings)
        doubt_s = took_s / 2.0 + _CLOCKS_AGREE_S
        return 0.0 if -_RENEWED_S - doubt_s <= ahead_s <= doubt_s else ahead_s

    def note(self, reading: Reading) -> None:
        """Take one more reading into account."""
        self._readings.append(reading)

    async def read(self, connection: Connection) -> None:
        """Read it once.

        Raises
        ------
        SourceLost
        """
        ids = (
            ua.ObjectIds.Server_ServerStatus_StartTime,
            ua.ObjectIds.Server_ServerStatus_CurrentTime,
        )
        asked = self._clock.monotonic()
        with connection.errors("reading the source's time"):
            answers = await read_values(connection, [ua.NodeId(number) for number in ids])
        took_s = self._clock.monotonic() - asked
        started, said = map(_ns_of, answers)
        if started != self.started:
            self.started = started
            self._readings.clear()
        if said:
            self.note(Reading((said - self._clock.now()) * 1e-9, took_s))

    def follow(self, connection: Connection) -> None:
        """Read it now and then, until `stop`."""
        self._following = asyncio.create_task(self._read_for_ever(connection))

    async def stop(self) -> None:
        """Read it no more; safe to call twice."""
        following, self._following = self._following, None
        if following is not None:
            following.cancel()
            await asyncio.gather(following, return_exceptions=True)

    async def _read_for_ever(self, connection: Connection) -> None:
        while True:
            await asyncio.sleep(READ_EVERY_S)
            try:
                await self.read(connection)
            except SourceError:
                return  # who receives notices it, too


def _ns_of(answer: ua.DataValue) -> int:
    value = None if answer.Value is None else answer.Value.Value
    return utc_ns(value) if isinstance(value, datetime) else 0
