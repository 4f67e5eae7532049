"""Ports to the plant's servers: sources of samples.

An adapter neither retries nor logs an error that it raises. It raises one of the typed errors of
:mod:`valvemap.errors`; the supervisor retries.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from valvemap.model.samples import Floats
from valvemap.pipeline.data_changes import DataChanges


@dataclass(frozen=True)
class SourceCounters:
    """Counters of the source adapter since its creation, over all connections."""

    notifications: int = 0
    publish_responses: int = 0
    missing_messages: int = 0
    overflows: int = 0
    undecodable: int = 0
    from_history: int = 0


class Upstream(Protocol):
    """Interface of one source, or of several as one, without the connection."""

    async def write_required_U(self, valve: int, U: float) -> None:
        """Write the feed-forward voltage (%) of one valve to its node at the source.

        Raises
        ------
        SourceLost, SourceRejected
        """

    async def write_heartbeat(self, valve: int, count: int) -> None:
        """Write the heartbeat (UInt32) of one valve to its node at the source.

        Raises
        ------
        SourceLost, SourceRejected
        """

    @property
    def mark(self) -> Any:  # noqa: ANN401 - the source's private type
        """Mark of the last changes returned; None: none yet."""

    def hold_back(self) -> None:
        """From now on, keep returned changes unacknowledged until `commit`."""

    def commit(self, mark: Any) -> None:  # noqa: ANN401
        """Acknowledge changes up to ``mark``: they are safe, and the source may drop them."""

    def position(self, mark: Any) -> bytes:  # noqa: ANN401
        """Return the position of ``mark``, as accepted by `resume_at` after a restart."""

    def resume_at(self, position: bytes) -> bool:
        """Resume from a saved position, if the source still can; call before `connect`.

        Returns False if it is not a position of this source; it is then ignored.
        """

    @property
    def counters(self) -> SourceCounters:
        """Counters since the creation of the adapter."""

    @property
    def clock_offset_s(self) -> float | Floats:
        """Offset of the source's clock from ours, s, positive if ahead; 0 if unknown.

        With several sources, an array by valve.
        """

    @property
    def remarks(self) -> Mapping[int, tuple[str, ...]]:
        """By number of the valve, sentences on its nodes that are not as configured."""


class AllSources(Upstream, Protocol):
    """All sources of a service."""

    @property
    def states(self) -> tuple[str, ...]:
        """One line for each source: its connection, and its losses."""


class Source(Upstream, Protocol):
    """A source of data changes.

    Order of calls: ``connect``, then ``receive`` and ``write`` in any order, then ``close``;
    after ``close`` or a :class:`~valvemap.errors.SourceLost`, ``connect`` may be called again.
    Cancelling ``receive`` loses nothing: the next call returns the changes that have arrived.
    """

    async def connect(self) -> None:
        """Connect, check every node, subscribe.

        Raises
        ------
        SourceLost
            if the server cannot be reached: retry.
        SourceRejected
            if it refuses certificate, user or node: names the node and the permitted values.
        """

    async def receive(self) -> DataChanges:
        """Wait for data changes and return all that have arrived, in order.

        Raises
        ------
        SourceLost
            if the connection was cut, or fell silent for longer than its keep-alives allow.
        """

    async def drop(self) -> None:
        """Abandon a lost connection; the source's queue for this client remains for `connect`."""

    @property
    def is_held(self) -> bool:
        """Whether the source may still queue changes for this client."""

    async def close(self) -> None:
        """Disconnect for good; may be called twice, and after a loss."""

    @property
    def started(self) -> int:
        """Start time of the source, UTC ns, read at `connect`; 0 if unknown.

        Before the first connection that of the position it resumes at.
        """
