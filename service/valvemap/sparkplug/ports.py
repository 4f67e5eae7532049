"""What is asked of the service and of the broker; `valvemap.app.mqtt` brings them together."""

from collections.abc import Collection, Sequence
from typing import Protocol

from valvemap.readings import Child, Reading
from valvemap.sparkplug.edge_node import Message


class Service(Protocol):
    """The service, as any OPC UA client sees it; nodes are named by their string identifiers.

    All but ``close`` raise `valvemap.errors.SourceLost` or `SourceRejected`.
    """

    @property
    def url(self) -> str:
        """Where it is."""

    @property
    def lost(self) -> int:
        """Changes that were sent over this connection and not taken in time."""

    async def connect(self) -> None:
        """Connect and log in."""

    async def close(self) -> None:
        """Disconnect; safe to call twice."""

    async def browse_each(self, ids: Sequence[str | None]) -> Sequence[Sequence[Child]]:
        """Nodes below each node."""

    async def scalar_types(self, ids: Sequence[str]) -> Sequence[str | None]:
        """Names of the standard's types of variables; None of arrays."""

    async def read(self, ids: Sequence[str | int]) -> Sequence[Reading]:
        """Values of variables, one each; a number names one of the standard's."""

    async def watch(self, ids: Collection[str], every_s: float) -> None:
        """Be sent what changes of just these variables, so often, the last value at least.

        SourceRejected: there is no room for it, and nothing is followed.
        """

    def changes(self) -> Sequence[tuple[str, Reading]]:
        """Take what was sent of them, in its order."""


class Session(Protocol):
    """A connection to the broker; all but ``close`` raise `valvemap.errors.SinkLost`."""

    def publish(self, message: Message) -> None:
        """Send, without waiting."""

    async def confirm(self) -> None:
        """Wait until the broker has everything that was published.

        `valvemap.errors.SinkRejected`: we may not listen to our commands.
        """

    def received(self) -> list[Message]:
        """Take the messages that came."""

    async def close(self) -> None:
        """End it; safe to call twice, and after a loss."""


class Broker(Protocol):
    """Where sessions are made."""

    @property
    def refused_packets(self) -> int:
        """Packets that were not received, each with its connection."""

    @property
    def url(self) -> str:
        """Where it is."""

    async def connect(self, will: Message, topics: Sequence[str]) -> Session:
        """Connect; ``topics`` are listened to, the first is that of our commands.

        SinkLost: worth another try. SinkRejected: it refuses us, or its certificate is not trusted.
        """
