"""The source adapter: an OPC UA client that returns arrays and never retries."""

from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from valvemap.clock import Clock
from valvemap.errors import SourceLost, SourceRejected
from valvemap.model.estimator import key_of
from valvemap.opcua_client.connection import open_connection
from valvemap.opcua_client.source_settings import SourceSettings
from valvemap.opcua_source.checked_nodes import check_nodes
from valvemap.opcua_source.command_writing import write_to_nodes
from valvemap.opcua_source.position import Mark, position_from_bytes, position_to_bytes
from valvemap.opcua_source.recall import recall
from valvemap.opcua_source.received import Left
from valvemap.opcua_source.source_nodes import HEARTBEAT, REQUIRED_U, ValveNodes
from valvemap.opcua_source.source_units import Scales, check_units
from valvemap.opcua_source.subscribed_source import SubscribedSource
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.source_ports import SourceCounters


class OpcUaSource(SubscribedSource):
    """Data changes of the given valves from one OPC UA server.

    Fulfils :class:`~valvemap.pipeline.source_ports.Source`.
    Every sample is requested, constant signals included (trigger StatusValueTimestamp), with queues
    long enough that none is lost between two publishing cycles. The time of a change is its
    SourceTimestamp, exact to the nanosecond, or the ServerTimestamp if the server sends none.

    Parameters
    ----------
    settings
        Server, security, intervals.
    valves
        The nodes of each valve; the order gives the valves their numbers in
        :class:`~valvemap.pipeline.data_changes.DataChanges`.
    clock
        Clock of the watchdog and of the comparison with the source's clock.
    ready
        Awaited before the first changes are returned; changes that arrive earlier are buffered.
    """

    def __init__(
        self,
        settings: SourceSettings,
        valves: Sequence[ValveNodes],
        clock: Clock | None = None,
        ready: Callable[[], Awaitable[None]] | None = None,
    ) -> None:
        super().__init__(settings, valves, clock)
        self._ready = ready
        self._scales = Scales(self._valves)

    @property
    def counters(self) -> SourceCounters:
        """Counters over all connections."""
        return SourceCounters(**vars(self._tally))

    @property
    def remarks(self) -> Mapping[int, tuple[str, ...]]:
        """By number of the valve, sentences on its nodes that are not as configured."""
        return self._watch.remarks

    async def receive(self) -> DataChanges:
        """Wait for data changes and return all received ones, in order and in our units.

        A gap is filled from the source's history before the changes after it are returned.

        Raises
        ------
        SourceLost
            if the connection was lost, or three keep-alives are missing.
        """
        if self._ready is not None:
            await self._ready()
            self._ready = None
        changes = DataChanges.empty()
        while not len(changes):
            if not self._filled.parts:
                if self._subscription is None:
                    raise SourceLost(f"{self._settings.url}: not connected")
                self._filled.parts += await self._subscription.buffer.receive()
            changes = await self._filled.next(self.started, self._tally)
        return self._scales(changes)

    @property
    def mark(self) -> Mark | None:
        """The position of the last returned changes; None before the first."""
        return self._filled.mark

    def hold_back(self) -> None:
        """Acknowledge messages from now on only after `commit`, so that the source keeps them."""
        self._holds_back = True
        if self._subscription is not None:
            self._subscription.acknowledgements.hold_back()

    def commit(self, mark: Mark) -> None:
        """Acknowledge all messages up to a mark: their changes are stored."""
        if self._subscription is not None:
            self._subscription.acknowledgements.commit(mark.subscription, mark.message)

    def position(self, mark: Mark) -> bytes:
        """Return the position of a mark as bytes, for `resume_at` after a restart."""
        known = self._subscription or self._left
        if known is None or known.created.SubscriptionId != mark.subscription:
            return position_to_bytes(self._binding, mark, None, ())
        items = known.items if isinstance(known, Left) else known.watched.items
        return position_to_bytes(self._binding, mark, known.created, items)

    def resume_at(self, position: bytes) -> bool:
        """Resume at a stored position on the next connect, if the server has the subscription.

        Returns False if the position is damaged or belongs to another source; it is ignored then.
        """
        items = len(self._filled.knowledge.known_to)
        latest = self._clock.now() + _MOST_AHEAD_NS
        self._known_position = position_from_bytes(position, self._binding, items, latest)
        if self._known_position is None:
            return False
        self._source_clock.started = self._known_position.started
        return True

    async def check(self) -> None:
        """Connect, check every node and disconnect, without a subscription.

        Raises
        ------
        SourceLost, SourceRejected, CertificateError
            as :meth:`connect`.
        """
        connection = await open_connection(self._settings)
        try:
            await check_units(connection, self._valves, await check_nodes(connection, self._valves))
        finally:
            await connection.close()

    async def recall(self, start: int, stop: int) -> AsyncIterator[DataChanges]:
        """Yield the changes of a time span (UTC ns) from the source's history, then disconnect.

        Raises
        ------
        SourceLost, SourceRejected, CertificateError
            as :meth:`connect`; SourceRejected also if the source keeps no history.
        """
        connection = await open_connection(self._settings)
        try:
            nodes = await check_nodes(connection, self._valves)
            await check_units(connection, self._valves, nodes)
            async for changes in recall(connection, nodes.monitored, start, stop):
                yield self._scales(changes)
        finally:
            await connection.close()

    async def write_required_U(self, valve: int, U: float) -> None:
        """Write the feed-forward voltage (%) of one valve to its node at the source.

        Raises
        ------
        SourceLost
            if the connection is lost.
        SourceRejected
            if the valve has no such node, or the server rejects the value.
        """
        await self._write(valve, REQUIRED_U, U)

    async def write_heartbeat(self, valve: int, count: int) -> None:
        """Write the heartbeat (UInt32) of one valve to its node at the source.

        Raises
        ------
        SourceLost, SourceRejected
            as :meth:`write_required_U`.
        """
        await self._write(valve, HEARTBEAT, count)

    async def write_commands(self, valve: int, commands: Mapping[str, float]) -> dict[str, str]:
        """Write commands of one valve in one request; ``commands`` by role: U in %, load in bar.

        Returns
        -------
        dict
            By role, why the server rejected a command; empty if it took all of them.

        Raises
        ------
        SourceLost
        """
        if self._connection is None:
            raise SourceLost(f"{self._settings.url}: not connected")
        return await write_to_nodes(self._connection, self._valves, self._writable, valve, commands)

    async def _write(self, valve: int, role: str, number: float) -> None:
        refused = await self.write_commands(valve, {role: number})
        if refused:
            raise SourceRejected(refused[role])

    @cached_property
    def _binding(self) -> str:
        """Key of server, user and nodes in their order, checked on resume; 0.1 ms per valve."""
        return key_of(_Binding(self._settings.url, self._settings.user, self._valves))


@dataclass(frozen=True)
class _Binding:
    url: str
    user: str | None
    valves: tuple[ValveNodes, ...]


_MOST_AHEAD_NS = 86_400_000_000_000  # 1 day; limit on a stored time ahead of our clock
