"""Ports to the service and to the broker; `valvemap.app.mqtt` connects them."""

from collections.abc import Collection, Sequence
from typing import Any, Protocol

from valvemap.readings import Child, Engineering, Reading
from valvemap.sparkplug.edge_node import Message


class Service(Protocol):
    """The service as an OPC UA server; nodes are named by their string identifiers.

    All methods but ``close`` raise `valvemap.errors.SourceLost` or `SourceRejected`.
    """

    @property
    def url(self) -> str:
        """URL of the server."""

    @property
    def lost(self) -> int:
        """Number of notifications lost on this connection by overflow."""

    async def connect(self) -> None:
        """Connect and authenticate."""

    async def close(self) -> None:
        """Disconnect; idempotent."""

    async def browse_each(self, ids: Sequence[str | None]) -> Sequence[Sequence[Child]]:
        """Return the children of each node."""

    async def scalar_types(self, ids: Sequence[str]) -> Sequence[str | None]:
        """Return the standard data type of each variable; None for arrays."""

    async def engineering(self, ids: Sequence[str]) -> Sequence[Engineering]:
        """Return units, ranges and descriptions of variables."""

    async def read(self, ids: Sequence[str | int]) -> Sequence[Reading]:
        """Read variables; a number is the identifier of a standard node."""

    async def watch(self, ids: Collection[str], every_s: float) -> None:
        """Subscribe to exactly these variables; under overflow, the last value is delivered.

        SourceRejected: the server has no room for it, and nothing is subscribed.
        """

    def changes(self) -> Sequence[tuple[str, Reading]]:
        """Return the notifications received since the last call, in order."""

    async def write(self, id: str, value: float) -> None:  # noqa: A002 - OPC UA's word
        """Write a Double. `valvemap.errors.CommandRejected`: the server refuses it."""

    async def call(
        self, owner: str, method: str, inputs: Sequence[Sequence[float | str]]
    ) -> Sequence[tuple[Any, ...]]:
        """Call a method of ``owner`` for each of the inputs.

        `valvemap.errors.CommandRejected`: the server refuses a call.
        """


class Session(Protocol):
    """A connection to the broker; all but ``close`` raise `valvemap.errors.SinkLost`."""

    def publish(self, message: Message) -> None:
        """Publish without waiting."""

    async def confirm(self) -> None:
        """Wait until the broker has received everything published so far.

        `valvemap.errors.SinkRejected`: the broker refuses the subscription to commands.
        """

    def received(self) -> list[Message]:
        """Return the messages received since the last call."""

    async def close(self) -> None:
        """Disconnect; idempotent, also after a loss."""


class Broker(Protocol):
    """Opens sessions."""

    @property
    def refused_packets(self) -> int:
        """Number of packets refused; each closed its connection."""

    @property
    def lost_messages(self) -> int:
        """Number of messages received and dropped: they found no room, or are too large."""

    @property
    def url(self) -> str:
        """URL of the broker."""

    async def connect(self, will: Message, topics: Sequence[str]) -> Session:
        """Connect, and subscribe to ``topics``, which are filters; the first is the command topic.

        Messages of one filter take no room from those of another.

        SinkLost: a retry may succeed. SinkRejected: the broker refuses the connection, or its
        certificate is not trusted.
        """
