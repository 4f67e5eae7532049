"""The source adapter: an OPC UA client that returns arrays and never retries."""

from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from valvemap.clock import Clock, SystemClock
from valvemap.errors import SourceLost, SourceRejected
from valvemap.model.estimator import key_of
from valvemap.opcua_client.connection import Connection, Ticket, open_connection
from valvemap.opcua_client.source_settings import Security, SourceSettings
from valvemap.opcua_source.checked_nodes import (
    CheckedNodes,
    MonitoredNode,
    WritableNode,
    check_nodes,
)
from valvemap.opcua_source.command_writing import write_to_nodes
from valvemap.opcua_source.filled_changes import FilledChanges
from valvemap.opcua_source.item_watch import ItemWatch
from valvemap.opcua_source.position import Mark, Position, position_from_bytes, position_to_bytes
from valvemap.opcua_source.recall import recall
from valvemap.opcua_source.received import Left, Tally
from valvemap.opcua_source.source_clock import SourceClock
from valvemap.opcua_source.source_nodes import HEARTBEAT, REQUIRED_U, ValveNodes
from valvemap.opcua_source.source_units import Scales, check_units
from valvemap.opcua_source.subscribing import LIFETIME_S, subscribe, take_over
from valvemap.opcua_source.subscription import Subscription
from valvemap.opcua_source.succession import Estate, divided
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.source_ports import SourceCounters
from valvemap.vocabulary.signals import PER_VALVE

__all__ = ["OpcUaSource", "Security", "SourceSettings", "ValveNodes"]


class OpcUaSource:
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
        self._settings = settings
        self._valves = tuple(valves)
        self._clock = clock or SystemClock()
        self._ready = ready
        self._heir: Callable[[Estate], None] | None = None
        self._surplus: tuple[int, ...] | None = None  # items of a predecessor; None: no predecessor
        self._tally = Tally()
        self._watch = ItemWatch(settings, self._valves, self._clock)
        self._source_clock = SourceClock(self._clock)
        self._connection: Connection | None = None
        self._ticket: Ticket | None = None
        self._left: Left | None = None
        self._left_at = 0.0
        self._filled = FilledChanges(
            len(self._valves) * PER_VALVE, settings.history_s, settings.warm_start_s
        )
        self._holds_back = False
        self._known_position: Position | None = None
        self._subscription: Subscription | None = None
        self._writable: dict[tuple[int, str], WritableNode] = {}
        self._scales = Scales(self._valves)

    @property
    def counters(self) -> SourceCounters:
        """Counters over all connections."""
        return SourceCounters(**vars(self._tally))

    @property
    def remarks(self) -> Mapping[int, tuple[str, ...]]:
        """By number of the valve, sentences on its nodes that are not as configured."""
        return self._watch.remarks

    @property
    def started(self) -> int:
        """Start time of the server, UTC ns, as read on connecting; 0 if it has none.

        Before the first connection that of the position it resumes at.
        """
        return self._source_clock.started

    @property
    def clock_offset_s(self) -> float:
        """Offset of the source's clock, s; positive if it is ahead of ours."""
        return self._source_clock.ahead_s

    async def connect(self) -> None:
        """Connect; resume the subscription kept by the server, or check every node and subscribe.

        Raises
        ------
        SourceLost
            if the server cannot be reached; a retry may succeed.
        SourceRejected
            if it rejects the certificate, the user or a node; names the node.
        CertificateError
            if our own certificate or key cannot be used.
        """
        await self.drop()
        connection = await open_connection(self._settings, self._ticket)
        try:
            await self._source_clock.read(connection)
            subscription = await self._take_over(connection) or await self._subscribe(connection)
        except BaseException:
            await (connection.hang_up() if self.is_held else connection.close())
            raise
        self._connection, self._subscription = connection, subscription
        self._source_clock.follow(connection)
        self._watch.start(connection, subscription)
        self._filled.read_history_over(
            connection, (item.node for item in subscription.watched.items)
        )

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
                self._filled.parts += await self._subscription.receive()
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

    def succeed(self, before: "OpcUaSource") -> None:
        """Take over the subscription of another source when that is closed.

        Signals that both sources monitor lose no data. Both must have the same `identity`;
        otherwise this source subscribes separately.
        """
        if before.identity == self.identity:
            self._source_clock.started = before.started
            before.bequeath(self.inherit)

    @property
    def identity(self) -> tuple[object, ...]:
        """The owner of a session: server, security and credentials."""
        settings = self._settings
        return settings.url, settings.security, settings.user, settings.password

    def bequeath(self, heir: Callable[[Estate], None]) -> None:
        """Hand the subscription to ``heir`` on `close`, instead of deleting it."""
        self._heir = heir

    def inherit(self, estate: Estate) -> None:
        """Continue with the state of another source that was closed."""
        ours = divided(estate, self._valves)
        self._filled.knowledge, self._tally, self._ticket = ours.knowledge, ours.tally, ours.ticket
        self._filled.parts.extend(part for part in ours.parts if len(part.changes))
        self._left, self._left_at, self._surplus = ours.left, ours.left_at, ours.surplus

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

    @property
    def is_held(self) -> bool:
        """Whether the server may still hold our subscription with unread changes."""
        return self._left is not None and self._clock.monotonic() - self._left_at < LIFETIME_S

    async def drop(self) -> None:
        """Close the socket only; the server keeps the subscription. Safe to call twice."""
        await self._source_clock.stop()
        await self._watch.stop()
        subscription, self._subscription = self._subscription, None
        connection, self._connection = self._connection, None
        if subscription is not None:
            await subscription.stop()
            self._leave(subscription)
        if connection is not None:
            self._ticket = connection.ticket
            await connection.hang_up()

    def _leave(self, subscription: Subscription) -> None:
        left = subscription.left()
        self._left, self._left_at = left, self._clock.monotonic()
        self._filled.parts += left.buffer

    async def _take_over(self, connection: Connection) -> Subscription | None:
        """Resume the subscription of the previous connection, if the server still has it."""
        if self._left is None and self._known_position is not None:
            nodes = await self._check_nodes(connection)
            self._resume(self._known_position, nodes.monitored)
        self._known_position = None
        if self._left is None:
            return None
        surplus = self._surplus
        checked = None if surplus is None else await self._check_nodes(connection)
        found = await take_over(connection, self._left, self._tally, self._clock, self._watch.table)
        if found is not None:
            subscription, available = found
            known = False
            try:
                known = await subscription.catch_up(available)
            finally:
                self._leave(subscription)
            if known:
                subscription.start()
                if checked is not None and surplus is not None:
                    await subscription.watched.change(checked.monitored, surplus)
                    self._surplus = None
                return subscription
        self._left = self._surplus = None
        return None

    def _resume(self, position: Position, nodes: Sequence[MonitoredNode]) -> None:
        self._filled.knowledge.known_to[:] = position.known_to
        self._left, self._left_at = position.left(nodes), self._clock.monotonic()

    async def _check_nodes(self, connection: Connection) -> CheckedNodes:
        """Check every node; once all were usable, unusable ones are watched instead of refused."""
        before = self._watch.namespaces
        nodes = await check_nodes(connection, self._valves, before, lenient=bool(before))
        await check_units(connection, self._valves, nodes)
        self._writable = nodes.writable
        self._watch.accept(nodes)
        return nodes

    @cached_property
    def _binding(self) -> str:
        """Key of server, user and nodes in their order, checked on resume; 0.1 ms per valve."""
        return key_of(_Binding(self._settings.url, self._settings.user, self._valves))

    async def _subscribe(self, connection: Connection) -> Subscription:
        nodes = await self._check_nodes(connection)
        source_now = self._clock.now() + round(self.clock_offset_s * 1e9)
        self._filled.begin_earlier(nodes.monitored, source_now)
        self._filled.knowledge.doubt()
        return await subscribe(
            connection,
            nodes.monitored,
            self._tally,
            self._clock,
            self._watch.table,
            hold_back=self._holds_back,
        )

    def _estate(self) -> Estate:
        return Estate(
            self._valves,
            self._filled.knowledge,
            tuple(self._filled.parts),
            self._tally,
            self._ticket,
            self._left,
            self._left_at,
            self._surplus or (),
        )

    async def close(self) -> None:
        """Disconnect; safe to call twice, and after a loss."""
        heir, self._heir = self._heir, None
        if heir is not None:
            await self.drop()
            heir(self._estate())
        await self._source_clock.stop()
        await self._watch.stop()
        self._left = self._ticket = None
        subscription, self._subscription = self._subscription, None
        connection, self._connection = self._connection, None
        if subscription is not None:
            await subscription.stop()
        if connection is not None:
            await connection.close()


@dataclass(frozen=True)
class _Binding:
    url: str
    user: str | None
    valves: tuple[ValveNodes, ...]


_MOST_AHEAD_NS = 86_400_000_000_000  # 1 day; limit on a stored time ahead of our clock
