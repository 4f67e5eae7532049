"""The offset of a source's clock: read on connecting and periodically afterwards."""

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
_READINGS = 6  # kept: one minute, in which a busy source may report late times
_CLOCKS_AGREE_S = 0.1  # smaller offsets are treated as zero
_PLACES = 3  # decimals of a step of our clock, s
_RENEWED_S = 1.0  # longest update interval of a server's CurrentTime


class Reading(NamedTuple):
    """One reading, s: offset of the source's clock from ours (positive: ahead), and round trip.

    Ours is the time of day when the service started plus the monotonic time since then, so a step
    of this machine's clock does not change the offset.
    """

    ahead_s: float
    took_s: float


class SourceClock:
    """The offset of a source's clock against ours.

    A reading never overestimates the server's time. It may be too early by the transmission delay,
    by up to 1 s because many servers update CurrentTime once per second, and by more if the server
    is busy. The estimate is therefore the maximum over the last minute. A clock that was set
    back is therefore noticed late here; :mod:`valvemap.pipeline.sample_clocks` bridges that time.

    Parameters
    ----------
    clock
        Our clock.

    Attributes
    ----------
    started
        StartTime of the server, UTC ns; 0 if it has none.

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
        self._began = clock.now() - round(clock.monotonic() * 1e9)
        self._readings: deque[Reading] = deque(maxlen=_READINGS)
        self._following: asyncio.Task[None] | None = None
        self.started = 0

    @property
    def ahead_s(self) -> float:
        """Offset from our time of day, s, positive if ahead; 0 if within the uncertainty.

        Without a reading, the source is assumed not to follow steps of this machine's clock.
        """
        ours_s = round((self._steady_ns() - self._clock.now()) * 1e-9, _PLACES)
        ahead_s, took_s = max(self._readings, default=Reading(0.0, 0.0))
        ahead_s += ours_s
        doubt_s = took_s / 2.0 + _CLOCKS_AGREE_S
        return 0.0 if -_RENEWED_S - doubt_s <= ahead_s <= doubt_s else ahead_s

    def note(self, reading: Reading) -> None:
        """Add a reading."""
        self._readings.append(reading)

    async def read(self, connection: Connection) -> None:
        """Read the server's StartTime and CurrentTime once.

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
            self.note(Reading((said - self._steady_ns()) * 1e-9, took_s))

    def _steady_ns(self) -> int:
        """Our time, UTC ns, without the steps of this machine's clock since the start."""
        return self._began + round(self._clock.monotonic() * 1e9)

    def follow(self, connection: Connection) -> None:
        """Read the clock periodically, until `stop`."""
        self._following = asyncio.create_task(self._read_for_ever(connection))

    async def stop(self) -> None:
        """Stop reading; safe to call twice."""
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
                return  # the receiver gets the error, too


def _ns_of(answer: ua.DataValue) -> int:
    value = None if answer.Value is None else answer.Value.Value
    return utc_ns(value) if isinstance(value, datetime) else 0
