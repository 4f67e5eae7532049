"""Commands of operators and their replies, as human-readable JSON messages."""

import json
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from valvemap.errors import BlockError, CommandRejected
from valvemap.kafka.json_messages import (
    LATEST,
    MOST_BYTES,
    MOST_NAME,
    MOST_TEXT,
    loads,
    numbers,
    text,
    whole,
)
from valvemap.pipeline import operator_ports
from valvemap.pipeline.alarm_results import Remark
from valvemap.pipeline.alarm_rules import ALARM_NAMES
from valvemap.pipeline.identification import Identification
from valvemap.vocabulary import commands
from valvemap.vocabulary.commands import Subject

VERSION: Final = 1
_COMMAND: Final = "command"
_REPLY: Final = "reply"


@dataclass(frozen=True)
class Command:
    """A command for one valve.

    Attributes
    ----------
    id
        Identifies the reply.
    group, valve
        Addressed group and valve.
    action
        One of ``ACTIONS``.
    estimator
        Name of the estimator or alarm that the action is on; else empty.
    values
        Arguments of the action: a forgetting factor; a flow and a pressure drop; U, dp and T; the
        time, UTC ns. None stands for NaN.
    comment, by
        Comment on an alarm, and its author.
    """

    id: str
    group: str
    valve: str
    action: str
    estimator: str = ""
    values: tuple[float | None, ...] = ()
    comment: str = ""
    by: str = ""


@dataclass(frozen=True)
class Reply:
    """Result of a command: executed after block ``number`` of its group, or a reason.

    ``values`` are the answer to a query; None stands for NaN.
    """

    id: str
    group: str
    number: int
    done: bool
    reason: str = ""
    values: tuple[float | None, ...] = ()


NOTHING: Final = ""
ESTIMATOR: Final = "estimator"
ALARM: Final = "alarm"

_ON: Final = {Subject.ESTIMATOR: ESTIMATOR, Subject.ALARM: ALARM}

# Each action: its object beside the valve, and its number of values.
ACTIONS: Final = {
    **{a.name: (_ON.get(a.on, NOTHING), a.values) for a in commands.ACTIONS if a.in_fleet},
    "predict": (ESTIMATOR, 3),
    "predict_measurement": (ESTIMATOR, 3),
    "invert": (NOTHING, 3),
    "compare": (ESTIMATOR, 0),
    "predict_approved": (ESTIMATOR, 3),
}
_TEXTS: Final = {  # text fields of a command: maximum length, characters
    **dict.fromkeys(("id", "group", "valve", "action", "estimator"), MOST_NAME),
    **dict.fromkeys(("comment", "by"), MOST_TEXT),
}
ANSWERS: Final = {
    "predict": 3,
    "predict_measurement": 4,
    "invert": 4,
    "compare": 5,
    "predict_approved": 3,
}
QUESTIONS: Final = tuple(ANSWERS)  # name: number of values in the answer
_MOST_VALUES: Final = max(ANSWERS.values())  # values in a command or a reply


def carry_out(command: Command, operator: Identification) -> tuple[float | None, ...]:
    """Execute a command; return the answer if it is a query.

    Raises
    ------
    CommandRejected
        with the reason; nothing is changed.
    """
    on, n = ACTIONS.get(command.action, (NOTHING, -1))
    if n != len(command.values):
        raise CommandRejected(
            f"{command.action} with {len(command.values)} values: there are "
            + ", ".join(f"{name} ({count})" for name, (_, count) in ACTIONS.items())
        )
    if on == ALARM and command.estimator not in ALARM_NAMES:
        raise CommandRejected(f"no alarm {command.estimator!r}: there are {', '.join(ALARM_NAMES)}")
    who = (command.valve, command.estimator) if on else (command.valve,)
    values = [float("nan") if value is None else value for value in command.values]
    if command.action in ANSWERS:
        return _numbers(command.action, getattr(operator, command.action)(*who, *values))
    given: list[Any] = [*values]
    if on == ALARM:
        given = [Remark(command.comment, command.by, int(command.values[0] or 0))]
    operator.do(operator_ports.Command.of(command.action, *who, *given))
    return ()


def _numbers(action: str, found: Any) -> tuple[float | None, ...]:  # noqa: ANN401 - of any action
    match action:
        case "invert":
            found = (found.U[0], found.lower[0], found.upper[0], found.status[0])
        case "compare":
            found = (found.mean, found.largest, found.U, found.dp, found.points)
        case _:
            pass
    return tuple(float(value) if np.isfinite(value) else None for value in found)


def write_message(message: Command | Reply) -> bytes:
    """Encode a command or a reply.

    >>> read_reply(write_message(Reply("7", "north.0", 12, done=True))).number
    12
    """
    kind = _COMMAND if isinstance(message, Command) else _REPLY
    return json.dumps({"valvemap": kind, "version": VERSION, **asdict(message)}).encode()


def is_reply(message: bytes) -> bool:
    """Whether a message on the results topic is a reply rather than a block."""
    return message.startswith(b"{")


def read_command(message: bytes) -> Command:
    """Decode a command.

    Raises
    ------
    BlockError
        if it is invalid or has another version.
    """
    said = _read(message, _COMMAND)
    texts = {name: text(name, said.pop(name, ""), most) for name, most in _TEXTS.items()}
    values = numbers(said.pop("values", []), _MOST_VALUES)
    if said:
        raise BlockError(f"a command: {', '.join(map(str, said))[:MOST_NAME]} cannot be so")
    on, _ = ACTIONS.get(texts["action"], (NOTHING, 0))
    if on == ALARM and not all(value is None or 0 <= value <= LATEST for value in values):
        raise BlockError(f"a command: the time of {texts['action']} is 0 to {LATEST} ns")
    return Command(**texts, values=values)


def read_reply(message: bytes) -> Reply:
    """Decode a reply.

    Raises
    ------
    BlockError
        if it is invalid or has another version.
    """
    said = _read(message, _REPLY)
    done = said.pop("done", None)
    if not isinstance(done, bool):
        raise BlockError("a reply: done is true or false")
    reply = Reply(
        id=text("id", said.pop("id", None)),
        group=text("group", said.pop("group", None)),
        number=whole("number", said.pop("number", None)),
        done=done,
        reason=text("reason", said.pop("reason", ""), MOST_TEXT),
        values=numbers(said.pop("values", []), _MOST_VALUES),
    )
    if said:
        raise BlockError(f"a reply: {', '.join(map(str, said))[:MOST_NAME]} cannot be so")
    return reply


def _read(message: bytes, kind: str) -> dict[str, Any]:
    if len(message) > MOST_BYTES:
        raise BlockError(f"{len(message)} bytes: a {kind} has at most {MOST_BYTES}")
    try:
        said = loads(message)
    except BlockError as error:
        raise BlockError(f"not a {kind}: {error}") from None
    if not isinstance(said, dict) or said.pop("valvemap", None) != kind:
        raise BlockError(f"not a {kind}")
    version = said.pop("version", None)
    if type(version) is not int or version != VERSION:
        raise BlockError(f"a {kind} of version {version!r:.40}, this one knows {VERSION}")
    return said
