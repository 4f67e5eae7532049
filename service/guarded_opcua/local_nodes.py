"""The inside of a server: nodes and single values, as their owner handles them."""

import dataclasses
import datetime as dt
from collections.abc import Callable, Coroutine, Iterable
from typing import Any

from asyncua import Server, ua
from asyncua.server.address_space import AddressSpace, AttributeValue
from asyncua.server.internal_session import InternalSession

from guarded_opcua.address_space.asyncua_server import AsyncuaServer
from guarded_opcua.address_space.declarations import Method, Value, Variable
from guarded_opcua.address_space.insertion import many_nodes
from guarded_opcua.address_space.node_sets import import_node_set
from guarded_opcua.address_space.packed_nodes import make_later
from guarded_opcua.address_space.plain_values import as_variant
from guarded_opcua.address_space.watchers import drive, notify
from guarded_opcua.binary.encoding import instant, nanoseconds
from guarded_opcua.clock import Clock, SystemClock
from guarded_opcua.errors import ServerError
from guarded_opcua.settings import ServerSettings
from guarded_opcua.subscriptions.registry import Subscriptions

Update = tuple[Variable, Value, int, int]


class LocalNodes:
    """Nodes and values of a server that only its owner can reach.

    Attributes
    ----------
    ua
        asyncua's server, for importing node sets and making events; it never listens.
    namespace_index
        Index of the namespace of the server's own nodes.
    """

    def __init__(self, settings: ServerSettings, clock: Clock | None = None) -> None:
        self.settings = settings
        self.namespace_index = 0
        self._clock = clock or SystemClock()
        self._inside = AsyncuaServer(settings.cache)
        self.ua = Server(iserver=self._inside)
        self._variables: dict[ua.NodeId, Variable] = {}
        self._methods: dict[ua.NodeId, Method] = {}
        self._made_at: int | None = None  # when the lazy folder being populated was added
        self._subscriptions = Subscriptions(self._inside.aspace, settings.limits, self._clock)

    @property
    def session(self) -> InternalSession:
        """The server's internal session, which has all permissions."""
        return self._inside.isession

    @property
    def address_space(self) -> AddressSpace:
        """All nodes."""
        return self._inside.aspace

    async def namespace(self, uri: str) -> int:
        """Return the index of a namespace, registering it if it is new."""
        return int(await self.ua.register_namespace(uri))

    async def add_node_set(self, text: str) -> None:
        """Add the nodes of a UANodeSet, in namespaces other than the server's, before the start.

        The nodes that the set refers to must exist.

        Raises
        ------
        ServerError
            if the node set cannot be parsed or imported.
        """
        try:
            await import_node_set(self.ua, self._inside.aspace, text)
        except (ua.UaError, ValueError, KeyError, SyntaxError) as error:
            raise ServerError(f"a UANodeSet cannot be imported: {error}") from error

    def utc(self) -> dt.datetime:
        """Return the time of day, or the time of addition while a lazy folder is populated."""
        return instant(self._added_at())

    def add_later(self, folder: ua.NodeId, add: Callable[[], Coroutine[Any, Any, None]]) -> None:
        """Populate a folder lazily, when a client first accesses a node below it.

        Clients see no difference. Of a thousand similar folders few are ever accessed; the others
        cost neither start-up time nor memory.

        Parameters
        ----------
        folder
            An object without children. The identifiers of all nodes below it begin with its own
            and a dot, and those of no other node.
        add
            Adds the nodes; it must not suspend. It may add further lazy folders.
        """
        added_at = self._added_at()

        def make() -> None:
            before, self._made_at = self._made_at, added_at
            try:
                with many_nodes():
                    drive(add())
            finally:
                self._made_at = before

        make_later(self._inside.aspace, folder, make)

    def register_variable(self, variable: Variable, value: Value) -> None:
        """Register a variable and publish its first value (called by ``add_variable``)."""
        self._variables[variable.id] = variable
        waiting = ua.StatusCodes.BadWaitingForInitialData
        code = waiting if value is None else ua.StatusCodes.Good
        self.write([(variable, value, code, self._added_at())])

    def register_method(self, method: Method) -> None:
        """Register a method (called by ``add_method``)."""
        self._methods[method.id] = method

    def write(self, updates: Iterable[Update]) -> None:
        """Publish values in order, without yielding to the event loop.

        Parameters
        ----------
        updates
            Tuples (variable, value, status code, source time in UTC ns). With a Bad status the
            value is dropped, as OPC UA Part 4, 7.7.1 demands; Uncertain keeps it.
        """
        server_time = instant(self._clock.now())
        stamp, source_time = None, server_time
        for variable, value, code, nanoseconds_ in updates:
            if nanoseconds_ != stamp:
                stamp, source_time = nanoseconds_, instant(nanoseconds_)
            content = (
                ua.Variant()
                if code & 0x8000_0000
                else as_variant(variable.type, value, array=variable.array)
            )
            data = ua.DataValue(content, ua.StatusCode(code), source_time, server_time)
            self._write_data_value(variable.id, data)

    def mark(self, variable: Variable, code: int) -> None:
        """Change the status of a variable's value, keeping value and source time."""
        held = self._inside.aspace.read_attribute_value(variable.id, ua.AttributeIds.Value)
        server_time = instant(self._clock.now())
        data = dataclasses.replace(
            held, StatusCode=ua.StatusCode(code), ServerTimestamp=server_time
        )
        self._write_data_value(variable.id, data)

    def write_property(self, id_: ua.NodeId, value: ua.Variant) -> None:
        """Publish a property of the server."""
        now = instant(self._clock.now())
        self._write_data_value(id_, ua.DataValue(value, ua.StatusCode(), now, now))

    def _write_data_value(self, nodeid: ua.NodeId, data: ua.DataValue) -> None:
        if place := self._subscriptions.items.blocks.get(nodeid):
            block, column = place
            block.take(block.batch_of(column, data))
            return
        held = self._inside.aspace[nodeid].attributes[ua.AttributeIds.Value]
        held.value = data
        held.value_callback = None
        ledger = self._subscriptions.ledger
        ledger.moment += 1
        if held.datachange_callbacks:
            notify(held, data)
        ledger.moment += 1

    def _value(self, variable: Variable) -> AttributeValue:
        return self._inside.aspace[variable.id].attributes[ua.AttributeIds.Value]

    def _added_at(self) -> int:
        return self._clock.now() if self._made_at is None else self._made_at

    def _take_write(self, variable: Variable, value: Value, at: dt.datetime | None) -> None:
        source = self._clock.now() if at is None else nanoseconds(at)
        self.write([(variable, value, ua.StatusCodes.Good, source)])
