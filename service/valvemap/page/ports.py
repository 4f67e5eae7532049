"""The page's port to the service: `valvemap.opcua_client.results_client` implements it."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from valvemap.readings import Child, ConditionChange, Course, Engineering, Reading


class Client(Protocol):
    """Client of a server whose own nodes have string identifiers.

    All methods but ``close`` raise `valvemap.errors.SourceLost` or `SourceRejected`.
    """

    @property
    def url(self) -> str:
        """URL of the server."""

    async def connect(self) -> None:
        """Connect and log in."""

    async def close(self) -> None:
        """Disconnect; idempotent."""

    async def browse(self, id: str | None) -> Sequence[Child]:  # noqa: A002 - OPC UA's word
        """Return the children of a node; None is the Objects folder."""

    async def read(self, ids: Sequence[str | int]) -> Sequence[Reading]:
        """Read variables; a number is the identifier of a standard node."""

    async def engineering(self, ids: Sequence[str]) -> Sequence[Engineering]:
        """Return units, ranges and descriptions of variables."""

    async def follow(self, ids: Collection[str], every_s: float) -> None:
        """Subscribe to exactly these variables; an empty collection ends the subscription.

        SourceRejected: the server has no room for it, and nothing is subscribed.
        """

    def changes(self) -> Sequence[tuple[str, Reading]]:
        """Return the notifications received since the last call, in order."""

    async def call(
        self, owner: str, method: str, inputs: Sequence[Sequence[float | str]]
    ) -> Sequence[tuple[Any, ...]]:
        """Call a method once for each set of inputs."""

    async def write(self, id: str, value: float) -> None:  # noqa: A002 - OPC UA's word
        """Write a Double."""

    async def permitted(self, ids: Sequence[str]) -> Sequence[bool]:
        """Whether the user may write each of these variables, or call each of these methods."""

    async def courses(
        self, asked: Sequence[tuple[str, str]], span: tuple[int, int], every_ns: int
    ) -> Sequence[Course]:
        """Read aggregates (Average, Minimum, Maximum) of variables from the server's history.

        CommandRejected: the server keeps none.
        """

    async def past_conditions(self, span: tuple[int, int], most: int) -> Sequence[ConditionChange]:
        """Return the newest changes of all alarms in a span (UTC ns), the newest first.

        CommandRejected: the server keeps none.
        """

    async def listen(self, every_s: float) -> None:
        """Subscribe to the changes of all alarms; those that wait for an operator come first.

        SourceRejected: the server has no room for it.
        """

    def conditions(self) -> Sequence[ConditionChange]:
        """Return the changes of alarms received since the last call, in order."""

    async def comment(self, condition: str, event: bytes, text: str) -> None:
        """Add a comment to a condition, of which ``event`` is an EventId."""


@dataclass
class Wanted:
    """Things in view, by number: valves, maps of estimators, lines and axes.

    Valves ``from_afar`` are shown once a second, which costs the service nothing: their frames are
    read anyway.
    """

    live: set[int] = field(default_factory=set)
    from_afar: set[int] = field(default_factory=set)
    parts: set[int] = field(default_factory=set)
    maps: set[tuple[int, str]] = field(default_factory=set)
