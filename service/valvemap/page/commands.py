"""Commands of a logged-in user: demands, alarms, maps, guided runs; in a demo, the rig."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from valvemap.errors import CommandRejected, SourceLost
from valvemap.page.log_ins import LogIn
from valvemap.page.ports import Client

_LONGEST_NAME = 100
_LONGEST_COMMENT = 200
_LONGEST_EVENT = 128  # hexadecimal digits of an EventId


@dataclass(frozen=True)
class _Write:
    """Write a Double."""

    node: str
    value: float

    async def take(self, client: Client) -> None:
        await client.write(self.node, self.value)


@dataclass(frozen=True)
class _Call:
    """Call a method once."""

    owner: str
    method: str
    inputs: tuple[float | str, ...] = ()

    @property
    def node(self) -> str:
        return f"{self.owner}.{self.method}"

    async def take(self, client: Client) -> None:
        await client.call(self.owner, self.method, [list(self.inputs)])


@dataclass(frozen=True)
class _Comment:
    """Comment on a change of an alarm."""

    alarm: str
    event: bytes
    text: str

    @property
    def node(self) -> str:
        return f"{self.alarm}.Acknowledge"  # the method of the condition is one of all servers

    async def take(self, client: Client) -> None:
        await client.comment(f"{self.alarm}.Condition", self.event, self.text)


_Step = _Write | _Call | _Comment


async def carry_out(log_in: LogIn, command: dict[str, Any]) -> None:
    """Carry out one command with the user's own rights.

    Raises
    ------
    CommandRejected
        if the command is unknown, or the server refuses it.
    SourceLost, SourceRejected
    """
    client = _client(log_in, command)
    for step in _steps(command):
        await step.take(client)


async def may_carry_out(log_in: LogIn, command: dict[str, Any]) -> bool:
    """Whether the server would let the user carry out a command; nothing is written.

    Raises
    ------
    CommandRejected
        if the command is unknown.
    SourceLost, SourceRejected
    """
    nodes, before = [step.node for step in _steps(command)], log_in.connections
    try:
        return all(await _client(log_in, command).permitted(nodes))
    except SourceLost:  # the service was away: its sessions ended
        await log_in.reconnect(before)
        return all(await _client(log_in, command).permitted(nodes))


def _client(log_in: LogIn, command: dict[str, Any]) -> Client:
    if not ("scenario" in command or "fault" in command):
        return log_in.service
    if log_in.rig is None:
        raise CommandRejected("there is no virtual rig here")
    return log_in.rig


def _steps(command: dict[str, Any]) -> Sequence[_Step]:
    """What a command asks of the server, in this order."""
    match command:
        case {"demand": str() as name}:
            return _demand(f"{_checked(name)}.Inverse", command)
        case {"alarm": str() as alarm, "of": str() as owner, "comment": str() as text}:
            alarm = f"{_checked(owner)}.Alarms.{_checked(alarm)}"
            return (_answer(alarm, _short(text), command),)
        case {"baseline": str() as valve, "do": "Approve" | "RollBack" as step}:
            return (_Call(f"{_checked(valve)}.Baseline", step),)
        case {"run": str() as valve}:
            return (_guide(f"{_checked(valve)}.Commission", command),)
        case _:
            return (_play(command),)


def _demand(inverse: str, command: dict[str, Any]) -> Sequence[_Step]:
    """Demand a flow of a valve or line, or a speed of an axis."""
    match command:
        case {"Q": float() | int() as Q, "dp": float() | int() as dp}:
            return (
                _Write(f"{inverse}.PressureDrop", _finite(dp)),
                _Write(f"{inverse}.FlowDemand", _finite(Q)),
            )
        case {"v": float() | int() | None as v}:
            return (_Write(f"{inverse}.SpeedDemand", math.nan if v is None else _finite(v)),)
        case _:
            raise CommandRejected("no such command")


def _answer(alarm: str, text: str, command: dict[str, Any]) -> _Step:
    """Acknowledge, confirm or comment on an alarm."""
    match command:
        case {"do": "Acknowledge" | "Confirm" as step}:
            return _Call(alarm, step, (text,))
        case {"do": "Comment", "event": str() as event}:
            return _Comment(alarm, _event(event), text)
        case _:
            raise CommandRejected("no such command")


def _play(command: dict[str, Any]) -> _Step:
    """Run or stop a scenario of the rig, or break something there."""
    match command:
        case {"scenario": ""}:
            return _Call("Rig", "StopScenario")
        case {"scenario": str() as scenario}:
            return _Call("Rig", "StartScenario", (_checked(scenario),))
        case {
            "fault": str() as kind,
            "valve": str() as valve,
            "size": float() | int() as size,
            "duration": float() | int() as duration,
        }:
            inputs = _checked(kind), _finite(size), _finite(duration)
            return _Call(_checked(valve), "InjectFault", inputs)
        case _:
            raise CommandRejected("no such command")


def _guide(run: str, command: dict[str, Any]) -> _Step:
    """Start or resume a guided run, keep it alive, or abort it."""
    match command:
        case {"do": "Start" | "Resume" as step, "accuracy": float() | int() as accuracy}:
            return _Call(run, step, (_finite(accuracy),))
        case {"do": "Heartbeat", "count": float() | int() as count}:
            return _Write(f"{run}.Heartbeat", _finite(count))
        case {"do": "Abort"}:
            return _Call(run, "Abort")
        case _:
            raise CommandRejected("no such command")


def _checked(name: str) -> str:
    if not name or len(name) > _LONGEST_NAME or not name.isprintable():
        raise CommandRejected("no such name")
    return name


def _finite(number: float) -> float:
    if not math.isfinite(number):
        raise CommandRejected("a number is needed")
    return float(number)


def _short(text: str) -> str:
    if len(text) > _LONGEST_COMMENT or (text and not text.isprintable()):
        raise CommandRejected(f"a comment has at most {_LONGEST_COMMENT} characters, in one line")
    return text


def _event(digits: str) -> bytes:
    try:
        return bytes.fromhex(digits[:_LONGEST_EVENT])
    except ValueError:
        raise CommandRejected("no such event") from None
