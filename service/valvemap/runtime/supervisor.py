"""The life cycle of a connection to a source: connect, receive, lose, retry."""

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
from valvemap.pipeline.source_ports import Source
from valvemap.runtime.backoff import backoff

log = structlog.get_logger(__name__)


class Consumer(Protocol):
    """Consumer of the data changes; the supervisor makes one call at a time."""

    async def connected(self, valves: Times | None = None, *, restarted_at: int | None) -> None:
        """The source is connected.

        ``restarted_at`` is its start time, UTC ns, if it was restarted since it was last connected,
        in a former life too; else None. After a kill the same restart may be told again.
        ``valves`` are the numbers of the valves that it publishes; None: all.
        """

    async def take(self, changes: DataChanges, valves: Times | None = None) -> None:
        """Process data changes from the source of these valves."""

    async def tick(self, valves: Times | None = None) -> None:
        """Called about every ``tick_s`` for each source, connected or not."""

    async def lost(self, reason: SourceError, valves: Times | None = None) -> None:
        """The connection to the source of these valves is lost or could not be made."""


@dataclass(frozen=True)
class SupervisorSettings:
    """Times in s; ``startup_timeout_s`` = 0 waits for the source without limit.

    Until the first connection, a source that is unreachable for ``startup_timeout_s`` or rejects
    the client ends the run with its error: the configuration is wrong. After it, every error is an
    outage of the plant and is retried without limit. ``connected_before`` applies the latter from
    the start. ``name`` identifies one of several sources in the log.
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
    """Keep ``source`` connected and pass its changes to ``consumer`` until ``stop`` is set.

    Raises
    ------
    SourceLost, SourceRejected
        only before the first connection, see :class:`SupervisorSettings`.
    """
    say = log if settings.name is None else log.bind(source=settings.name)
    started, source_started = clock.monotonic(), source.started
    ever_connected = settings.connected_before
    pauses = settings.pauses()
    try:
        while not stop.is_set():
            try:
                await source.connect()
                say.info("source connected")
                before, source_started = source_started, source.started
                restarted = 0 != before != source_started != 0
                await consumer.connected(restarted_at=source_started if restarted else None)
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
    """Receive until ``stop``; changes that were received are taken, however this ends."""
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
    finally:
        stopped.cancel()
        received = None if receiving is None else await _ended(receiving)
        if received is not None:
            with suppress(SourceLost):
                await consumer.take(received)


async def _ended(receiving: asyncio.Future[DataChanges]) -> DataChanges | None:
    """Cancel, and return the changes received all the same."""
    receiving.cancel()
    (outcome,) = await asyncio.gather(receiving, return_exceptions=True)
    return None if isinstance(outcome, BaseException) else outcome


async def _wait(stop: asyncio.Event, pause_s: float, consumer: Consumer, tick_s: float) -> None:
    left = pause_s
    while left > 0 and not stop.is_set():
        step = min(tick_s, left)
        with suppress(TimeoutError):
            await asyncio.wait_for(stop.wait(), step)
        await consumer.tick()
        left -= step
