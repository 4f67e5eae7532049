"""The life of one connection to a source: connect, receive, lose, try again."""

import asyncio
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Protocol

import structlog

from valvemap.clock import Clock
from valvemap.errors import SourceError, SourceLost, SourceRejected
from valvemap.model.samples import Times
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.ports import Source
from valvemap.runtime.backoff import backoff

log = structlog.get_logger(__name__)


class Consumer(Protocol):
    """Who uses the data changes; called by the supervisor, one call at a time."""

    async def connected(self, source_started: int, valves: Times | None = None) -> None:
        """There is a connection, to a source started then (UTC ns; 0: unknown).

        ``valves`` are the numbers of those that it publishes; None: all.
        """

    async def take(self, changes: DataChanges, valves: Times | None = None) -> None:
        """Data changes have arrived from the source of these valves."""

    async def tick(self, valves: Times | None = None) -> None:
        """Time has passed; called about every ``tick_s``, connected or not, for each source."""

    async def lost(self, reason: SourceError, valves: Times | None = None) -> None:
        """The connection is gone, or could not be made, to the source of these valves."""


@dataclass(frozen=True)
class SupervisorSettings:
    """Times in s; ``startup_timeout_s`` = 0 waits for the source for ever.

    Until the first connection a source that cannot be reached within ``startup_timeout_s``, or
    that rejects us, ends the run with its error: it is a mistake of the set-up. Afterwards it is
    trouble of the plant: everything is tried again, for ever. ``connected_before``: it is that from
    the start. ``name`` is that of one of several sources, to log it by.
    """

    startup_timeout_s: float = 10.0
    connected_before: bool = False
    name: str | None = None
    tick_s: float = 0.25
    longest_pause_while_held_s: float = 2.0
    pauses: Callable[[], Iterator[float]] = backoff


async def supervise(
    source: Source,
    consumer: Consumer,
    clock: Clock,
    stop: asyncio.Event,
    settings: SupervisorSettings,
) -> None:
    """Keep ``source`` connected and hand its changes to ``consumer`` until ``stop`` is set.

    Raises
    ------
    SourceLost, SourceRejected
        only before the first connection, see :class:`SupervisorSettings`.
    """
    say = log if settings.name is None else log.bind(source=settings.name)
    started = clock.monotonic()
    ever_connected = settings.connected_before
    pauses = settings.pauses()
    try:
        while not stop.is_set():
            try:
                await source.connect()
                say.info("source connected")
                await consumer.connected(source.started)
                ever_connected, pauses = True, settings.pauses()
                await _receive(source, consumer, stop, settings.tick_s)
            except (SourceLost, SourceRejected) as error:
                waited = clock.monotonic() - started
                hopeless = isinstance(error, SourceRejected) or (
                    0 < settings.startup_timeout_s <= waited
                )
                if hopeless and not ever_connected:
                    raise
                await source.drop()
                pause = next(pauses)
                if source.is_held:
                    pause = min(pause, settings.longest_pause_while_held_s)
                if ever_connected:
                    await consumer.lost(error)
                    say.warning("source lost", reason=str(error), next_try_in_s=pause)
                else:
                    say.info("waiting for the source", reason=str(error), next_try_in_s=pause)
                await _wait(stop, pause, consumer, settings.tick_s)
    finally:
        await source.close()


async def _receive(source: Source, consumer: Consumer, stop: asyncio.Event, tick_s: float) -> None:
    """Receive until ``stop``; a tick never cuts a receive short, so nothing can be lost by it."""
    stopped = asyncio.ensure_future(stop.wait())
    receiving: asyncio.Future[DataChanges] | None = None
    try:
        while not stop.is_set():
            receiving = receiving or asyncio.ensure_future(source.receive())
            waited_for: set[asyncio.Future[Any]] = {receiving, stopped}
            await asyncio.wait(waited_for, timeout=tick_s, return_when=asyncio.FIRST_COMPLETED)
            if receiving.done():
                changes, receiving = receiving.result(), None
                await consumer.take(changes)
            await consumer.tick()
        if receiving is not None and receiving.done() and not receiving.exception():
            await consumer.take(receiving.result())
    finally:
        for task in (stopped, receiving):
            if task is not None:
                task.cancel()
                await asyncio.gather(task, return_exceptions=True)


async def _wait(stop: asyncio.Event, pause_s: float, consumer: Consumer, tick_s: float) -> None:
    left = pause_s
    while left > 0 and not stop.is_set():
        step = min(tick_s, left)
        with suppress(TimeoutError):
            await asyncio.wait_for(stop.wait(), step)
        await consumer.tick()
        left -= step
