"""The subscription of a source over its connections: resumed, created again, or forwarded."""

from collections.abc import Callable, Sequence

from valvemap.clock import Clock, SystemClock
from valvemap.opcua_client.connection import Connection, Ticket, open_connection
from valvemap.opcua_client.source_settings import SourceSettings
from valvemap.opcua_source.checked_nodes import (
    CheckedNodes,
    MonitoredNode,
    WritableNode,
    check_nodes,
)
from valvemap.opcua_source.filled_changes import FilledChanges
from valvemap.opcua_source.item_watch import ItemWatch
from valvemap.opcua_source.position import Position
from valvemap.opcua_source.received import Left, Tally
from valvemap.opcua_source.source_clock import SourceClock
from valvemap.opcua_source.source_nodes import ValveNodes
from valvemap.opcua_source.source_units import check_units
from valvemap.opcua_source.subscribing import LIFETIME_S, subscribe, take_over
from valvemap.opcua_source.subscription import Subscription
from valvemap.opcua_source.succession import Estate, divided
from valvemap.vocabulary.signals import PER_VALVE


class SubscribedSource:
    """One OPC UA server, connected or not, with one subscription to the nodes of all valves.

    Parameters
    ----------
    settings, valves, clock
        As of :class:`~valvemap.opcua_source.client.OpcUaSource`.
    """

    def __init__(
        self, settings: SourceSettings, valves: Sequence[ValveNodes], clock: Clock | None = None
    ) -> None:
        self._settings = settings
        self._valves = tuple(valves)
        self._clock = clock or SystemClock()
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

    def succeed(self, before: "SubscribedSource") -> None:
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
