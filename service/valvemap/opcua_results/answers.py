"""Results of operator commands that may be asynchronous, e.g. from a worker of a fleet."""

import inspect
from collections.abc import Awaitable, Callable
from typing import TypeVar

from guarded_opcua import CommandRejected as Refused
from valvemap.errors import CommandRejected
from valvemap.pipeline.operator_ports import Answer

A = TypeVar("A")
B = TypeVar("B")


def say_nothing(_why: str) -> None:
    """Ignore a rejection."""


def answered(
    ask: Callable[[], Answer[A]],
    then: Callable[[A], B],
    refused: Callable[[str], None] = say_nothing,
) -> Answer[B]:
    """Call ``ask`` and apply ``then`` to its result, awaiting the result if it is awaitable.

    A CommandRejected of the service is raised as the server's CommandRejected, and its message is
    passed to ``refused``.
    """

    async def later(outcome: Awaitable[A]) -> B:
        try:
            found = await outcome
        except (CommandRejected, Refused) as rejected:
            refused(str(rejected))
            raise _as_refused(rejected) from rejected
        return then(found)

    try:
        outcome = ask()
    except (CommandRejected, Refused) as rejected:
        refused(str(rejected))
        raise _as_refused(rejected) from rejected
    return later(outcome) if inspect.isawaitable(outcome) else then(outcome)


def _as_refused(rejected: CommandRejected | Refused) -> Refused:
    return rejected if isinstance(rejected, Refused) else Refused(str(rejected))
