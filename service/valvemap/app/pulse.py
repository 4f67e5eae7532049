"""The supervisor's pulse: whether each source's supervision still calls its consumer."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final

from valvemap.clock import Clock
from valvemap.errors import SourceError
from valvemap.model.samples import Times
from valvemap.pipeline.data_changes import DataChanges
from valvemap.runtime.supervisor import Consumer

CONNECTING_S: Final = 600.0
"""s; longest silence of a supervisor while it connects: there is no tick, and each request for
thousands of nodes of a slow server may take the whole timeout."""


@dataclass
class _Beat:
    """One source: time of the last start or end of a call, and the allowance for the next."""

    at: float
    connected: bool = False
    under_way: bool = False

    @property
    def allowance_s(self) -> float:
        return 0.0 if self.connected or self.under_way else CONNECTING_S


class Pulse:
    """A consumer that forwards every call and records when it starts and ends.

    Parameters
    ----------
    consumer
        Receives the calls.
    clock
        Gives the recorded times.
    """

    def __init__(self, consumer: Consumer, clock: Clock) -> None:
        self._consumer, self._clock = consumer, clock
        self._began = _Beat(clock.monotonic())
        self._beats: dict[int, _Beat] = {}  # by the first valve of each source

    def overdue_s(self, now: float, tick_s: float) -> float:
        """Return by how much the supervisor's next beat is overdue, s; alive if at most 0.

        A connected source beats at least every ``tick_s``; while connecting it may be silent for
        ``CONNECTING_S`` longer. A call that does not return is a missing beat.
        """
        beats = self._beats.values() or [self._began]
        return now - min(beat.at + tick_s + beat.allowance_s for beat in beats)

    async def connected(self, valves: Times | None = None, *, restarted_at: int | None) -> None:
        """As `Consumer.connected`."""
        with self._call(valves) as beat:
            beat.connected = True
            await self._consumer.connected(valves, restarted_at=restarted_at)

    async def take(self, changes: DataChanges, valves: Times | None = None) -> None:
        """As `Consumer.take`."""
        with self._call(valves):
            await self._consumer.take(changes, valves)

    async def tick(self, valves: Times | None = None) -> None:
        """As `Consumer.tick`."""
        with self._call(valves):
            await self._consumer.tick(valves)

    async def lost(self, reason: SourceError, valves: Times | None = None) -> None:
        """As `Consumer.lost`."""
        with self._call(valves) as beat:
            beat.connected = False
            await self._consumer.lost(reason, valves)

    @contextmanager
    def _call(self, valves: Times | None) -> Iterator[_Beat]:
        first = -1 if valves is None or not len(valves) else int(valves[0])
        beat = self._beats.setdefault(first, _Beat(0.0))
        beat.at, beat.under_way = self._clock.monotonic(), True
        yield beat
        beat.at, beat.under_way = self._clock.monotonic(), False
