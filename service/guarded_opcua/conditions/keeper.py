"""The port of condition keepers, which hold the states of conditions."""

from collections.abc import Awaitable, Iterator, Sequence
from typing import Protocol

from asyncua import ua

from guarded_opcua.conditions.condition import Condition


class ConditionKeeper(Protocol):
    """Holds the states of conditions and executes their methods, synchronously or asynchronously.

    The keeper reports a changed condition by :meth:`HardenedServer.report` before the call ends.
    """

    def find(self, condition: ua.NodeId) -> Condition | None:
        """Return the state of a condition, None if it is unknown."""

    def retained(self) -> Iterator[Sequence[Condition]]:
        """Yield the retained conditions in groups."""

    def acknowledge(self, condition: ua.NodeId, comment: str) -> Awaitable[None] | None:
        """Acknowledge a condition unless it is; raise CommandRejected to refuse."""

    def confirm(self, condition: ua.NodeId, comment: str) -> Awaitable[None] | None:
        """Confirm a condition; raise CommandRejected to refuse."""

    def remark(self, condition: ua.NodeId, comment: str) -> Awaitable[None] | None:
        """Add a comment to a condition; raise CommandRejected to refuse."""
