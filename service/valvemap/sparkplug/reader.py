"""Subscribes to the service over OPC UA; reconnects and browses again after every loss."""

import asyncio
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Final

import structlog

from valvemap.clock import Clock
from valvemap.errors import CommandRejected, SourceLost, SourceRejected, ValvemapError
from valvemap.readings import Reading
from valvemap.sparkplug.commands import Commands, Order
from valvemap.sparkplug.metrics import GOOD, OVERFLOW, Value
from valvemap.sparkplug.ports import Service
from valvemap.sparkplug.service_variables import NODE_VERSION, find_variables
from valvemap.sparkplug.shown import OVERFLOWS, Shown

log = structlog.get_logger(__name__)

_READ_AT_ONCE: Final = 200  # nodes of one read: keeps responses well below the decoding limit
_LOOK_S: Final = 0.1  # s; poll interval of the notification buffer
_REFUSED_RETRY_S: Final = 10.0  # s; after a refusal, which rarely ends soon
_ASK_S: Final = 2.0  # s; interval of the keep-alive read
_CURRENT_TIME: Final = 2258  # node id in namespace 0: Server_ServerStatus_CurrentTime


class Reader:
    """Keeps the metrics up to date with the service.

    Parameters
    ----------
    service
        OPC UA client of the service.
    shown
        Receives variables and values.
    wanted
        Patterns of names, such as ``*.Residual``: those of valves without the valve's name, those
        of the service with ``Service.``.
    every_s
        Publishing interval of the subscription.
    clock
        Time source.
    pauses
        Makes the retry pauses, s; called after every successful connection.
    commands
        Commands of MQTT clients to carry out; None: none is allowed.
    """

    def __init__(
        self,
        service: Service,
        shown: Shown,
        wanted: Sequence[str],
        every_s: float,
        clock: Clock,
        pauses: Callable[[], Iterator[float]],
        commands: Commands | None = None,
    ) -> None:
        self._service, self._shown = service, shown
        self._commands = commands
        self._wanted, self._every_s = wanted, every_s
        self._clock, self._pauses = clock, pauses
        self._overflows = 0
        self._said = ""

    async def run(self) -> None:
        """Read until cancelled; reconnect after every failure."""
        pauses = self._pauses()
        while True:
            try:
                await self._service.connect()
                await self._find()
                self._say("", "service connected")
                pauses = self._pauses()
                await self._follow()
            except SourceLost as error:
                self._say(str(error), "service lost")
                pause = next(pauses)
            except ValvemapError as error:
                self._say(str(error), "service cannot be used")
                pause = _REFUSED_RETRY_S
            finally:
                self._shown.lose(self._clock.now())
                await self._service.close()
            await asyncio.sleep(pause)

    async def _find(self) -> None:
        allowed = () if self._commands is None else self._commands.allowed
        variables = await find_variables(self._service, self._wanted, allowed)
        ids = [one.id for one in variables if one.text is None]
        try:
            await self._service.watch(ids, self._every_s)
        except SourceRejected as error:
            raise SourceRejected(
                f"{error}; {len(ids)} variables are watched: name fewer in mqtt.variables"
            ) from error
        readings: list[Reading] = []
        early: list[tuple[str, Reading]] = []
        for start in range(0, len(ids), _READ_AT_ONCE):
            readings += await self._service.read(ids[start : start + _READ_AT_ONCE])
            early += self._service.changes()
        values = {id_: self._value(one) for id_, one in zip(ids, readings, strict=True)}
        now = self._clock.now()
        values |= {v.id: Value(v.text, GOOD, now) for v in variables if v.text is not None}
        self._shown.find(variables, values, now)
        self._take(early)
        if not variables:
            log.warning("mqtt.variables names none of the service's", patterns=list(self._wanted))

    async def _follow(self) -> None:
        asked_at = self._clock.monotonic()
        (version,) = await self._service.read([NODE_VERSION])
        while True:
            self._take(self._service.changes())
            await self._carry_out()
            if self._service.lost:
                self._overflows += self._service.lost
                raise SourceLost(f"{self._service.url}: it sent more than was read; read again")
            self._shown.count(OVERFLOWS, self._overflows, self._clock.now())
            if self._clock.monotonic() - asked_at >= _ASK_S:
                # without a keep-alive, a cut line goes unnoticed
                _, now = await self._service.read([_CURRENT_TIME, NODE_VERSION])
                if now.value != version.value:
                    raise SourceLost(
                        f"{self._service.url}: valves were added or removed; read again"
                    )
                asked_at = self._clock.monotonic()
            await asyncio.sleep(_LOOK_S)

    def _take(self, changes: Iterable[tuple[str, Reading]]) -> None:
        for id_, reading in changes:
            self._shown.change(id_, self._value(reading))

    async def _carry_out(self) -> None:
        """Give the service the commands that wait; its roles decide."""
        if self._commands is None:
            return
        for order in self._commands.take(self._clock.now()):
            try:
                await self._give(order)
            except CommandRejected as error:
                reason = str(error).removeprefix(f"{order.tag.id}: ")
                self._commands.refuse(order.tag.id, reason)
            except BaseException:
                self._commands.lost += 1  # it may have been carried out
                raise
            else:
                self._commands.done += 1
                log.info("command carried out", node=order.tag.id, value=order.value)

    async def _give(self, order: Order) -> None:
        if isinstance(order.value, str):
            owner, _, method = order.tag.id.rpartition(".")
            await self._service.call(owner, method, [[order.value]])
        else:
            await self._service.write(order.tag.id, order.value)

    def _value(self, reading: Reading) -> Value:
        """Convert a reading; count and clear the overflow bits of its StatusCode."""
        code = reading.code
        if code & OVERFLOW == OVERFLOW:
            self._overflows += 1
            code &= ~OVERFLOW
        return Value(reading.value, code, reading.t or self._clock.now())

    def _say(self, reason: str, event: str) -> None:
        """Log a reason once."""
        if reason == self._said and reason:
            return
        self._said = reason
        if reason:
            log.warning(event, reason=reason)
        else:
            log.info(event, url=self._service.url)
