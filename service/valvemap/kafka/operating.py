"""Operator interface of a fleet's results server: sends commands to the workers."""

import asyncio
import math
import uuid
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final, Protocol

import numpy as np

from valvemap.errors import BlockError, CommandRejected
from valvemap.kafka.commands import ANSWERS, Command, Reply, read_command, write_message
from valvemap.kafka.mirror import Mirror
from valvemap.model.inversion import Inversion
from valvemap.pipeline.alarm_results import AlarmReport, Remark
from valvemap.pipeline.operator_ports import Answer
from valvemap.pipeline.operator_ports import Command as Asked
from valvemap.pipeline.results import Version
from valvemap.pipeline.service_alarms import FLEET_RULES, ServiceAlarms
from valvemap.vocabulary.commands import NAMED, Action
from valvemap.vocabulary.statuses import InverseStatus, Status


class Post(Protocol):
    """Sends commands."""

    def send(self, command: Command, refused: Callable[[str], None]) -> None:
        """Send a command; on failure, call ``refused`` with the reason, from any thread."""

    def tend(self) -> None:
        """Process delivery reports; to be called regularly."""


@dataclass(frozen=True)
class _Moved:
    """Deviation of a map from the approved one; see `valvemap.pipeline.results.Compared`."""

    mean: float
    largest: float
    U: float
    dp: float
    points: int


class FleetOperator:
    """Implements :class:`valvemap.pipeline.operator_ports.Operator`; a worker answers each command.

    Parameters
    ----------
    groups
        Group of each valve, by name.
    numbers
        Number of each valve, by name.
    mirror
        Newest results of the valves.
    post
        Sends the commands.
    answer_s
        Timeout of an answer.
    quiet
        Initial alarms of each valve.
    """

    def __init__(
        self,
        groups: Mapping[str, str],
        numbers: Mapping[str, int],
        mirror: Mirror,
        post: Post,
        answer_s: float,
        quiet: Mapping[str, Sequence[AlarmReport]],
    ) -> None:
        self._groups, self._numbers, self._mirror = groups, numbers, mirror
        self._post, self._answer_s = post, answer_s
        self._quiet = quiet
        self._asked: dict[str, asyncio.Future[Reply]] = {}
        self.service_alarms = ServiceAlarms(FLEET_RULES)

    def take(self, reply: Reply) -> None:
        """Resolve the command that a reply answers; ignore replies to other servers."""
        asked = self._asked.get(reply.id)
        if asked is not None and not asked.done():
            asked.set_result(reply)

    def do(self, command: Asked) -> Answer[None]:
        """Carry out an operator's command on a valve, or (None) on the service's alarms."""
        action = NAMED[command.action]
        if command.valve is None:
            self._do_here(action, command)
            return None
        if not action.in_fleet:
            raise CommandRejected(f"{command.valve}: {NO_FEED_FORWARD}")
        return self._send(command.valve, command)

    def _do_here(self, action: Action, command: Asked) -> None:
        act = getattr(self.service_alarms, action.name)
        if act(command.part, command.remark) is False:
            raise CommandRejected(f"Service.{command.part}: there is nothing to {action.name}")

    async def _send(self, valve: str, command: Asked) -> None:
        remark = command.remark
        values = command.values if remark is None else (remark.t,)
        await self._ask(valve, command.action, command.part, *values, remark=remark)

    async def predict(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> tuple[float, float, Status]:
        """Return Q (l/min), its standard deviation and the estimator's status."""
        Q, std, status = await self._ask(valve, "predict", estimator, U, dp, T)
        return Q, std, _status(status)

    async def predict_measurement(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> tuple[float, float, float, Status]:
        """Return Q, the 95 % interval of a new measurement (l/min), and the estimator's status."""
        answer = await self._ask(valve, "predict_measurement", estimator, U, dp, T)
        Q, lower, upper, status = answer
        return Q, lower, upper, _status(status)

    async def invert(self, valve: str, Q: float, dp: float, T: float) -> Inversion:
        """Return U for a demanded flow at a pressure drop."""
        U, lower, upper, status = await self._ask(valve, "invert", "", Q, dp, T)
        code = np.array([_code(status, InverseStatus)], np.uint8)
        return Inversion(np.array([U]), np.array([lower]), np.array([upper]), code)

    async def compare(self, valve: str, estimator: str) -> _Moved:
        """Return the deviation of an estimator's map from the baseline."""
        mean, largest, U, dp, points = await self._ask(valve, "compare", estimator)
        return _Moved(mean, largest, U, dp, 0 if math.isnan(points) else int(points))

    async def predict_approved(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> tuple[float, float, Status]:
        """Return Q (l/min), its standard deviation and status, by the approved map."""
        Q, std, status = await self._ask(valve, "predict_approved", estimator, U, dp, T)
        return Q, std, _status(status)

    def baseline(self, valve: int) -> Version | None:
        """Return the baseline of a valve, by its number."""
        return self._mirror.baseline(valve)

    def alarmed(self) -> Iterable[str]:
        """Valves that have had an alarm."""
        return [name for name, number in self._numbers.items() if self._mirror.reports(number)]

    def alarms(self, valve: str | None) -> Sequence[AlarmReport]:
        """Return the states of all alarms of a valve, or (None) of the service."""
        if valve is None:
            return self.service_alarms.reports()
        return self._mirror.reports(self._numbers[valve]) or self._quiet[valve]

    async def _ask(
        self,
        valve: str,
        action: str,
        estimator: str = "",
        *values: float,
        remark: Remark | None = None,
    ) -> Any:  # noqa: ANN401
        """Send a command and wait for the reply; return its values."""
        loop, answer = asyncio.get_running_loop(), asyncio.Future[Reply]()
        command = Command(
            uuid.uuid4().hex,
            self._groups[valve],
            valve,
            action,
            estimator,
            tuple(None if math.isnan(value) else value for value in values),
            comment="" if remark is None else remark.text,
            by="" if remark is None else remark.by,
        )

        try:
            read_command(write_message(command))
        except BlockError as error:
            raise CommandRejected(f"{valve}: {error}") from None

        def refused(why: str) -> None:
            reply = Reply(command.id, command.group, 0, done=False, reason=why)
            loop.call_soon_threadsafe(self.take, reply)

        self._asked[command.id] = answer
        try:
            self._post.send(command, refused)
            async with asyncio.timeout(self._answer_s):
                reply = await answer
        except TimeoutError:
            raise CommandRejected(
                f"{valve}: no worker has answered within {self._answer_s:g} s; it may still be done"
            ) from None
        finally:
            del self._asked[command.id]
        if not reply.done:
            raise CommandRejected(reply.reason)
        if len(reply.values) != ANSWERS.get(action, 0):
            raise CommandRejected(f"{valve}: {_NO_ANSWER}")
        return tuple(math.nan if value is None else value for value in reply.values)


def _status(value: float) -> Status:
    return Status(_code(value, Status))


def _code(value: float, allowed: type[IntEnum]) -> int:
    """Decode a code from a worker, which may have another version."""
    if value not in [int(one) for one in allowed]:
        raise CommandRejected(_NO_ANSWER)
    return int(value)


_NO_ANSWER: Final = "the answer is none that this version knows"


NO_FEED_FORWARD: Final = "in a fleet nothing is written to valves: feed-forward needs `serve`"
