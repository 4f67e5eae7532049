"""The page's port to the service: `valvemap.opcua_client.results_client` implements it."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from valvemap.readings import Child, Reading


class Client(Protocol):
    """A server whose own nodes are named by their string identifiers.

    All but ``close`` raise `valvemap.errors.SourceLost` or `SourceRejected`.
    """

    @property
    def url(self) -> str:
        """Where it is."""

    async def connect(self) -> None:
        """Connect and log in."""

    async def close(self) -> None:
        """Disconnect; safe to call twice."""

    async def browse(self, id: str | None) -> Sequence[Child]:  # noqa: A002 - OPC UA's word
        """Nodes below a node; None is the Objects folder."""

    async def read(self, ids: Sequence[str | int]) -> Sequence[Reading]:
        """Values of variables; a number names one of the standard's."""

    async def follow(self, ids: Collection[str], every_s: float) -> None:
        """Be sent what changes of just these variables, so often; of none: end that.

        SourceRejected: there is no room for it, and nothing is followed.
        """

    def changes(self) -> Sequence[tuple[str, Reading]]:
        """Take what was sent of the variables that are followed, in its order."""

    async def call(
        self, owner: str, method: str, inputs: Sequence[Sequence[float | str]]
    ) -> Sequence[tuple[Any, ...]]:
        """Call a method once for each of the inputs."""

    async def write(self, id: str, value: float) -> None:  # noqa: A002 - OPC UA's word
        """Write a Double."""


@dataclass
class Wanted:
    """What viewers look at now: valves by number."""

    live: set[int] = field(default_factory=set)
    maps: set[tuple[int, str]] = field(default_factory=set)
