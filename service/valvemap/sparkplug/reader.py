"""Subscribes to the service over OPC UA; reconnects and browses again after every loss."""

import asyncio
from collections.abc import Callable, Iterable, Iterator, Sequence
from fnmatch import fnmatchcase
from typing import Final

import structlog

from valvemap.clock import Clock
from valvemap.errors import SourceLost, SourceRejected, ValvemapError
from valvemap.readings import Reading
from valvemap.sparkplug.metrics import OVERFLOW, Meaning, Value
from valvemap.sparkplug.ports import Service
from valvemap.sparkplug.schema import DataType
from valvemap.sparkplug.shown import OVERFLOWS, Shown, Variable
from valvemap.vocabulary.edges import split_id

log = structlog.get_logger(__name__)

_ROOT: Final = "Identification"
_OF_SERVICE: Final = "Service"
_NOT_FOLLOWED: Final = "Condition"  # alarm nodes: copies of other variables, created when browsed
_READ_AT_ONCE: Final = 200  # nodes of one read: keeps responses well below the decoding limit
_LOOK_S: Final = 0.1  # s; poll interval of the notification buffer
_REFUSED_RETRY_S: Final = 10.0  # s; after a refusal, which rarely ends soon
_ASK_S: Final = 2.0  # s; interval of the keep-alive read
_CURRENT_TIME: Final = 2258  # node id in namespace 0: Server_ServerStatus_CurrentTime
_VERSIONS: Final = ".NodeVersion"  # versions of the address space, not results
_VERSION: Final = f"{_ROOT}{_VERSIONS}"  # changes when valves are added or removed
_KINDS: Final = {
    "Boolean": DataType.BOOLEAN,
    "SByte": DataType.INT8,
    "Byte": DataType.UINT8,
    "Int16": DataType.INT16,
    "UInt16": DataType.UINT16,
    "Int32": DataType.INT32,
    "UInt32": DataType.UINT32,
    "Int64": DataType.INT64,
    "UInt64": DataType.UINT64,
    "Float": DataType.FLOAT,
    "Double": DataType.DOUBLE,
    "String": DataType.STRING,
    "LocalizedText": DataType.STRING,
    "DateTime": DataType.DATE_TIME,
}


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
    """

    def __init__(
        self,
        service: Service,
        shown: Shown,
        wanted: Sequence[str],
        every_s: float,
        clock: Clock,
        pauses: Callable[[], Iterator[float]],
    ) -> None:
        self._service, self._shown = service, shown
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
        variables = await self._variables()
        ids = [one.id for one in variables]
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
        self._shown.find(variables, values, self._clock.now())
        self._take(early)
        if not variables:
            log.warning("mqtt.variables names none of the service's", patterns=list(self._wanted))

    async def _follow(self) -> None:
        asked_at = self._clock.monotonic()
        (version,) = await self._service.read([_VERSION])
        while True:
            self._take(self._service.changes())
            if self._service.lost:
                self._overflows += self._service.lost
                raise SourceLost(f"{self._service.url}: it sent more than was read; read again")
            self._shown.count(OVERFLOWS, self._overflows, self._clock.now())
            if self._clock.monotonic() - asked_at >= _ASK_S:
                # without a keep-alive, a cut line goes unnoticed
                _, now = await self._service.read([_CURRENT_TIME, _VERSION])
                if now.value != version.value:
                    raise SourceLost(
                        f"{self._service.url}: valves were added or removed; read again"
                    )
                asked_at = self._clock.monotonic()
            await asyncio.sleep(_LOOK_S)

    def _take(self, changes: Iterable[tuple[str, Reading]]) -> None:
        for id_, reading in changes:
            self._shown.change(id_, self._value(reading))

    async def _variables(self) -> list[Variable]:
        """Browse the variables that match the patterns and are scalars of a supported type."""
        found: list[tuple[str, str | None, str]] = []
        level: list[str | None] = [_ROOT]
        while level:
            children = [child for some in await self._service.browse_each(level) for child in some]
            level = []
            for child in children:
                device, name = split_id(child.id)
                if child.id.endswith(_VERSIONS):
                    continue
                if child.is_variable:
                    owner = None if device == _OF_SERVICE else device
                    dotted = child.id if owner is None else name
                    if any(fnmatchcase(dotted, pattern) for pattern in self._wanted):
                        found.append((child.id, owner, dotted.replace(".", "/")))
                elif not child.is_method and child.id.rpartition(".")[2] != _NOT_FOLLOWED:
                    level.append(child.id)
        types = await self._service.scalar_types([id_ for id_, _, _ in found])
        scalars = [
            (*one, _KINDS[type_])
            for one, type_ in zip(found, types, strict=True)
            if type_ in _KINDS
        ]
        given = await self._service.engineering([id_ for id_, *_ in scalars])
        return [
            Variable(*one, Meaning(said.unit, said.range, said.description))
            for one, said in zip(scalars, given, strict=True)
        ]

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
