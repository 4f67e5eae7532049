"""The port behind which somebody knows how conditions stand."""

from collections.abc import Awaitable, Iterator, Sequence
from typing import Protocol

from asyncua import ua

from guarded_opcua.conditions.condition import Condition


class ConditionKeeper(Protocol):
    """Knows conditions and does what people ask for, at once or in a while.

    What changes of a condition is said by :meth:`HardenedServer.report`, before the call ends.
    """

    def find(self, condition: ua.NodeId) -> Condition | None:
        """How a condition stands; None: there is no such one."""

    def retained(self) -> Iterator[Sequence[Condition]]:
        """Those that are to be shown, a few at a time."""

    def acknowledge(self, condition: ua.NodeId, comment: str) -> Awaitable[None] | None:
        """Note that it was seen, if it was not; CommandRejected refuses."""

    def confirm(self, condition: ua.NodeId, comment: str) -> Awaitable[None] | None:
        """Note that it was dealt with; CommandRejected refuses."""

    def remark(self, condition: ua.NodeId, comment: str) -> Awaitable[None] | None:
        """Note what somebody said of it; CommandRejected refuses."""
