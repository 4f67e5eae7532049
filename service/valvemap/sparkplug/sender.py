"""Publishes the metrics over a persistent connection to the broker; the only place that retries."""

import asyncio
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Final

import structlog

from valvemap.clock import Clock
from valvemap.errors import SinkError, SinkLost
from valvemap.foreign_text import printable
from valvemap.sparkplug.commands import Commands
from valvemap.sparkplug.edge_node import REBIRTH, EdgeNode, Message
from valvemap.sparkplug.host import PrimaryHost
from valvemap.sparkplug.metrics import flag_in
from valvemap.sparkplug.outbox import Outbox
from valvemap.sparkplug.ports import Broker, Session
from valvemap.sparkplug.schema import DecodeError
from valvemap.sparkplug.shown import (
    COMMANDS_DONE,
    COMMANDS_LOST,
    COMMANDS_REFUSED,
    CONNECTIONS,
    LAST_REFUSAL,
    LOST,
    REFUSED,
    Shown,
)

log = structlog.get_logger(__name__)

_AT_ONCE: Final = 5_000  # unconfirmed changes: some 300 kB
_LOOK_S: Final = 0.1  # s; longest delay of a command, a loss or the service's return
_REFUSED_RETRY_S: Final = 10.0
_BETWEEN_BIRTHS_S: Final = 1.0  # s; shortest interval between two rebirths on request
_FAREWELL_S: Final = 2.0
_SAID_AGAIN_S: Final = 60.0


class HostGone(SinkLost):
    """The primary host is offline; changes wait for it."""


class Sender:
    """Publishes births, then the changes in the outbox.

    The next batch is published once the broker has confirmed the previous one. A stalled broker
    therefore does not fill our memory, and the changes it received before a loss are known.

    Parameters
    ----------
    broker, node, shown, outbox
        Destination, identity, metrics and their changes.
    every_s
        Publishing interval.
    host
        Primary host to wait for, if any.
    commands
        Takes the commands to devices; None: they are not subscribed to.
    clock
        Timestamps messages.
    pauses
        Makes the retry pauses, s; called after every successful connection.
    """

    def __init__(
        self,
        broker: Broker,
        node: EdgeNode,
        shown: Shown,
        outbox: Outbox,
        every_s: float,
        clock: Clock,
        pauses: Callable[[], Iterator[float]],
        host: PrimaryHost | None = None,
        commands: Commands | None = None,
    ) -> None:
        self._broker, self._node, self._host = broker, node, host
        self._commands = commands
        self._shown, self._outbox = shown, outbox
        self._every_s, self._clock, self._pauses = every_s, clock, pauses
        self._retry = pauses()
        self._connections = 0
        self._found_count = -1  # found_count at the last birth
        self._born, self._born_at = 0, 0.0  # newest change at the last birth, and its time, s
        self._devices_live = False
        self._births_wanted = False
        self._said = ""
        self._losses_said, self._losses_said_at = 0, -_SAID_AGAIN_S
        self._refusals_said, self._refusals_said_at = 0, -_SAID_AGAIN_S

    @property
    def is_sending(self) -> bool:
        """Whether the broker takes messages, and a primary host, if any, is online."""
        return self._connections > 0 and not self._said

    async def run(self) -> None:
        """Publish until cancelled; reconnect after every failure. Publishes NDEATH at the end."""
        while True:
            try:
                await self._serve_one_connection()
            except SinkLost as error:
                pause = next(self._retry)
                self._say(str(error))
            except SinkError as error:
                pause = _REFUSED_RETRY_S
                self._say(str(error))
            self._count_losses()
            await asyncio.sleep(pause)

    async def _serve_one_connection(self) -> None:
        will = self._node.will(self._clock.now())
        topics = [self._node.commands]
        topics += [] if self._host is None else [self._host.topic]
        topics += [] if self._commands is None else [self._node.device_commands]
        session = await self._broker.connect(will, topics)
        try:
            self._connections += 1
            self._shown.count(CONNECTIONS, self._connections, self._clock.now())
            await self._wait_for_host(session)
            self._say("")
            self._retry = self._pauses()
            await self._give_birth(session)
            await self._serve(session)
        except (asyncio.CancelledError, HostGone):
            await self._say_goodbye(session)
            raise
        finally:
            self._devices_live = False
            self._outbox.put_back()
            await session.close()

    async def _wait_for_host(self, session: Session) -> None:
        while True:
            with suppress(HostGone):
                self._listen(session)
            if not self._host_is_gone:
                return
            self._say(f"{self._broker.url}: connected; the primary host is not there")
            await asyncio.sleep(_LOOK_S)

    def _listen(self, session: Session) -> None:
        for message in session.received():
            if self._host is not None and message.topic == self._host.topic:
                self._host.hear(message.payload)
            elif message.topic == self._node.commands:
                self._births_wanted |= _asks_for_births(message.payload)
            elif self._commands is not None:
                self._take_command(self._commands, message)
        if self._host_is_gone:
            raise HostGone(f"{self._broker.url}: the primary host is gone")

    def _take_command(self, commands: Commands, message: Message) -> None:
        device = self._node.device_of(message.topic) or ""
        if self._devices_live and not self._host_is_gone:
            commands.hear(device, message, self._clock.now())
        else:
            commands.refuse(printable(device), "no birth of the device was published")

    async def _serve(self, session: Session) -> None:
        due = self._clock.monotonic() + self._every_s
        while True:
            await asyncio.sleep(min(_LOOK_S, self._every_s))
            self._listen(session)
            self._count_losses()
            now = self._clock.monotonic()
            waited = now - self._born_at >= _BETWEEN_BIRTHS_S
            if self._shown.found_count != self._found_count or (self._births_wanted and waited):
                await self._give_birth(session)
            elif not len(self._outbox):
                await self._bury_devices(session)
            elif now >= due:
                self._send(session)
                await session.confirm()
                self._outbox.confirm()
                if not len(self._outbox):
                    due = now + self._every_s

    async def _give_birth(self, session: Session) -> None:
        """Publish births; changes queued before are published later as historical."""
        self._devices_live = self._shown.is_connected or len(self._outbox) > 0
        tags = self._shown.tags
        if not self._devices_live:
            tags = {None: tags[None]}
        for message in self._node.births(tags, self._shown.newest, self._clock.now()):
            session.publish(message)
        self._found_count, self._births_wanted = self._shown.found_count, False
        self._born, self._born_at = self._outbox.newest, self._clock.monotonic()
        await session.confirm()

    def _send(self, session: Session) -> None:
        changes = self._outbox.take(_AT_ONCE)
        for message in self._node.data(changes, self._born, self._clock.now()):
            session.publish(message)

    async def _bury_devices(self, session: Session) -> None:
        """Publish DDEATH of all devices if the service is lost and the outbox is empty."""
        if self._shown.is_connected or not self._devices_live:
            return
        self._devices_live = False
        for device in self._shown.tags:
            if device is not None:
                session.publish(self._node.device_death(device, self._clock.now()))
        await session.confirm()

    async def _say_goodbye(self, session: Session) -> None:
        with suppress(SinkError, TimeoutError):
            async with asyncio.timeout(_FAREWELL_S):
                if self._shown.found_count == self._found_count and not self._host_is_gone:
                    self._send(session)
                session.publish(self._node.death(self._clock.now()))
                await session.confirm()
                self._outbox.confirm()

    @property
    def _host_is_gone(self) -> bool:
        return self._host is not None and not self._host.is_online

    def _count_losses(self) -> None:
        lost, now = self._outbox.lost, self._clock.monotonic()
        self._shown.count(LOST, lost, self._clock.now())
        self._shown.count(REFUSED, self._broker.refused_packets, self._clock.now())
        self._count_commands(now)
        if lost != self._losses_said and now - self._losses_said_at >= _SAID_AGAIN_S:
            self._losses_said, self._losses_said_at = lost, now
            log.warning("values found no room", lost=lost)

    def _count_commands(self, now: float) -> None:
        commands = self._commands
        if commands is None:
            return
        lost = commands.lost + self._broker.lost_messages
        for name, value in (
            (COMMANDS_DONE, commands.done),
            (COMMANDS_REFUSED, commands.refused),
            (COMMANDS_LOST, lost),
            (LAST_REFUSAL, commands.last_refusal),
        ):
            self._shown.count(name, value, self._clock.now())
        refused = commands.refused
        if refused != self._refusals_said and now - self._refusals_said_at >= _SAID_AGAIN_S:
            self._refusals_said, self._refusals_said_at = refused, now
            log.warning("commands refused", refused=refused, last=commands.last_refusal)

    def _say(self, reason: str) -> None:
        """Log a reason once."""
        if reason and reason == self._said:
            return
        self._said = reason
        if reason:
            log.warning("nothing can be sent", reason=reason, waiting=len(self._outbox))
        else:
            log.info("results are sent", url=self._broker.url)


def _asks_for_births(command: bytes) -> bool:
    try:
        return flag_in(command, REBIRTH)
    except DecodeError:
        return False
