"""What operators ask for, and what became of it, as messages: JSON, for people may look at them."""

import json
from dataclasses import asdict, dataclass
from typing import Any, Final

from service.errors import BlockError, CommandRejected
from service.streaming.ports import Operator

VERSION: Final = 1
_COMMAND: Final = "command"
_REPLY: Final = "reply"


@dataclass(frozen=True)
class Command:
    """One thing to be done with a valve.

    Attributes
    ----------
    id
        By which the reply is known.
    group, valve
        Whose.
    action
        One of ``ACTIONS``.
    estimator
        Where the action is on one of them; else empty.
    values
        What the action needs: a forgetting factor; a flow and a pressure drop.
    """

    id: str
    group: str
    valve: str
    action: str
    estimator: str = ""
    values: tuple[float | None, ...] = ()


@dataclass(frozen=True)
class Reply:
    """What became of a command: done after block ``number`` of its group, or why not."""

    id: str
    group: str
    number: int
    done: bool
    reason: str = ""


# Each action, whether it is one estimator's, and how many values it takes.
ACTIONS: Final = {
    "reset": (True, 0),
    "freeze": (True, 0),
    "resume": (True, 0),
    "set_forgetting_factor": (True, 1),
    "demand": (False, 2),
    "approve": (False, 0),
    "roll_back": (False, 0),
    "replace_valve": (False, 0),
}


def carry_out(command: Command, operator: Operator) -> None:
    """Do what is asked for.

    Raises
    ------
    CommandRejected
        saying why not; nothing is changed then.
    """
    on_estimator, n = ACTIONS.get(command.action, (False, -1))
    if n != len(command.values):
        raise CommandRejected(
            f"{command.action} with {len(command.values)} values: there are "
            + ", ".join(f"{name} ({count})" for name, (_, count) in ACTIONS.items())
        )
    who = (command.valve, command.estimator) if on_estimator else (command.valve,)
    values = (float("nan") if value is None else value for value in command.values)
    getattr(operator, command.action)(*who, *values)


def write_message(message: Command | Reply) -> bytes:
    """Pack a command or a reply.

    >>> read_reply(write_message(Reply("7", "north.0", 12, done=True))).number
    12
    """
    kind = _COMMAND if isinstance(message, Command) else _REPLY
    return json.dumps({"valvemap": kind, "version": VERSION, **asdict(message)}).encode()


def is_reply(message: bytes) -> bool:
    """Whether a message of the results is a reply rather than a block."""
    return message.startswith(b"{")


def read_command(message: bytes) -> Command:
    """Unpack a command.

    Raises
    ------
    BlockError
        if it is none, or of another version.
    """
    said = _read(message, _COMMAND)
    texts = {name: said.pop(name, "") for name in ("id", "group", "valve", "action", "estimator")}
    values = said.pop("values", [])
    wrong = [name for name, text in texts.items() if not isinstance(text, str)]
    if wrong or said:
        raise BlockError(f"a command: {', '.join([*wrong, *said])} cannot be so")
    if not isinstance(values, list) or not all(
        value is None or (isinstance(value, int | float) and not isinstance(value, bool))
        for value in values
    ):
        raise BlockError("a command: values must be numbers, or null")
    return Command(**texts, values=tuple(values))


def read_reply(message: bytes) -> Reply:
    """Unpack a reply.

    Raises
    ------
    BlockError
        if it is none, or of another version.
    """
    try:
        return Reply(**_read(message, _REPLY))
    except TypeError as error:
        raise BlockError(f"a reply: {error}") from None


def _read(message: bytes, kind: str) -> dict[str, Any]:
    try:
        said = json.loads(message)
    except (ValueError, RecursionError):
        raise BlockError(f"not a {kind}: not JSON") from None
    if not isinstance(said, dict) or said.pop("valvemap", None) != kind:
        raise BlockError(f"not a {kind}")
    version = said.pop("version", None)
    if version != VERSION:
        raise BlockError(f"a {kind} of version {version}, this one knows {VERSION}")
    return said
