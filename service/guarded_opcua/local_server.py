"""The inside of a server: nodes, values, histories and conditions, as their owner handles them."""

import dataclasses
import datetime as dt
from collections.abc import Callable, Collection, Coroutine, Iterable, Sequence
from typing import Any

import numpy as np
from asyncua import Server, ua
from asyncua.server.address_space import AddressSpace, AttributeValue
from asyncua.server.internal_session import InternalSession
from numpy.typing import ArrayLike, NDArray

from guarded_opcua.address_space.asyncua_server import AsyncuaServer
from guarded_opcua.address_space.blocks import Block
from guarded_opcua.address_space.declarations import Method, Value, Variable
from guarded_opcua.address_space.insertion import many_nodes, reference
from guarded_opcua.address_space.node_sets import import_node_set
from guarded_opcua.address_space.packed_nodes import is_below, make_later
from guarded_opcua.address_space.plain_values import as_variant
from guarded_opcua.address_space.removal import remove
from guarded_opcua.address_space.watchers import drive, notify
from guarded_opcua.binary.encoding import instant, nanoseconds
from guarded_opcua.clock import Clock, SystemClock
from guarded_opcua.conditions.calls import Conditions
from guarded_opcua.conditions.condition import Condition, ConditionKey
from guarded_opcua.conditions.keeper import ConditionKeeper
from guarded_opcua.conditions.nodes import ConditionNodes, references_to
from guarded_opcua.errors import ServerError
from guarded_opcua.history.events import EventHistorian
from guarded_opcua.history.historian import Historian
from guarded_opcua.history.offers import offer_events, offer_values, state_stored_fields
from guarded_opcua.history.reading import Histories
from guarded_opcua.monitoring.event_filter import event_of_asyncua
from guarded_opcua.settings import ServerSettings
from guarded_opcua.subscriptions.registry import Subscriptions

_EMITS = 1 << ua.EventNotifier.SubscribeToEvents

Update = tuple[Variable, Value, int, int]


class LocalServer:
    """A server that only its owner can reach: nodes, values, histories, conditions.

    Attributes
    ----------
    ua
        asyncua's server, for importing node sets and making events; it never listens.
    namespace_index
        Index of the namespace of the server's own nodes.
    conditions
        Reports changed conditions as events; ConditionRefresh returns their state later.
    events
        Emits events, also to clients that lost their sessions by what happened and reconnect.
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
        aspace = self._inside.aspace
        self._subscriptions = Subscriptions(aspace, settings.limits, self._clock)
        self.events = self._subscriptions.events
        self._inside.hand_events_to(self._trigger_event_of_asyncua)
        self._histories = Histories(settings.limits, aspace)
        self.conditions = Conditions(
            self._subscriptions, ConditionNodes(aspace, self._write_data_value), self._clock
        )
        self._has_history = self._has_past_events = False

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

    def add_block(self, variables: Sequence[Variable], length: int | None = None) -> Block:
        """Store variables of one type as arrays, to be written by :meth:`write_block`.

        Parameters
        ----------
        variables
            Variables that change together; each belongs to at most one block.
        length
            Length of the variables' values if they are arrays.

        Raises
        ------
        ServerError
            if the variables differ in type or are not numeric.
        """
        if not variables:
            raise ServerError("a block needs variables")
        block = self.add_empty_block(variables[0].type, length, len(variables))
        for variable in variables:
            block.check(variable)
        for column, variable in enumerate(variables):
            block.adopt(column, self._value(variable).value)
            self.show(variable, block, column)
        return block

    def add_empty_block(self, type_: ua.VariantType, length: int | None, n: int) -> Block:
        """Store n values of one type as arrays; variables are attached later by :meth:`show`.

        Until the first write their status is BadWaitingForInitialData.
        """
        ledger = self._subscriptions.ledger
        return Block(type_, n, length, ledger, self._clock.now())

    def show(self, variable: Variable, block: Block, column: int) -> None:
        """Attach a variable to one column of a block.

        Raises
        ------
        ServerError
            if the variable's type differs from the block's.
        """
        block.show(column, variable, self._value(variable))
        self._subscriptions.blocks[variable.id] = block, column

    def show_also(self, variable: Variable, of: Variable) -> None:
        """Give a variable the value of another one of its type, present and future."""
        aspace = self._inside.aspace
        value = ua.AttributeIds.Value
        aspace[variable.id].attributes[value] = aspace[of.id].attributes[value]
        place = self._subscriptions.blocks.get(of.id)
        if place is not None:
            self._subscriptions.blocks[variable.id] = place

    def write_block(
        self,
        block: Block,
        values: ArrayLike,
        source_times: ArrayLike,
        codes: ArrayLike = ua.StatusCodes.Good,
        present: ArrayLike | None = None,
        columns: ArrayLike | None = None,
    ) -> None:
        """Publish k successive samples of a block; equivalent to k calls of :meth:`write`.

        Parameters
        ----------
        block
            n variables.
        values
            Shape (k, n); (k, n, length) if the variables are arrays.
        source_times
            UTC ns, shape (k,) or (k, n).
        codes
            StatusCodes, one for all or of shape (k, n). A Bad one drops the value.
        present
            Shape (k, n), False where there is no sample; None: all True.
        columns
            The n columns that are written, each once, in any order; None: all columns.
        """
        block.take(block.batch(values, source_times, codes, present, self._clock.now(), columns))

    def remove(self, folders: Collection[ua.NodeId], referrers: Collection[ua.NodeId]) -> None:
        """Remove folders and all nodes below; their monitored items report BadNodeIdUnknown.

        Parameters
        ----------
        folders
            As in :meth:`add_later`.
        referrers
            All nodes that refer to them.
        """
        names = {(folder.NamespaceIndex, str(folder.Identifier)) for folder in folders}
        places, gone = self._subscriptions.blocks, dict[Block, set[int]]()
        for id_ in list(places):
            if is_below(id_.NamespaceIndex, str(id_.Identifier), names):
                block, column = places.pop(id_)
                gone.setdefault(block, set()).add(column)
        for block, columns in gone.items():
            block.take(block.unknown(sorted(columns), self._clock.now()))
        removed = remove(self._inside.aspace, folders, referrers, self._clock.now())
        for id_ in removed:
            self._variables.pop(id_, None)
            self._methods.pop(id_, None)
        self.conditions.nodes.forget(removed)

    def add_history(self, variables: Sequence[Variable], historian: Historian) -> None:
        """Offer HistoryRead of variables; the historian is queried with each request.

        Call it before the start, even with no variables yet, so that the server announces
        HistoryRead in its capabilities.

        Raises
        ------
        ServerError
            if a variable is not a scalar number.
        """
        self._has_history = True
        for variable in variables:
            offer_values(self._inside.aspace, variable)
            self._histories.add(variable, historian)

    def add_event_history(
        self, sources: Iterable[ua.NodeId], historian: EventHistorian, fields: Iterable[str]
    ) -> None:
        """Offer HistoryRead of the events of objects; call it before the start.

        Parameters
        ----------
        sources
            The objects; all share the property HistoricalEventFilter (Part 11, 5.3.2).
        historian
            Stores the events.
        fields
            Browse paths of the event fields that are stored; the first call sets them for all.
        """
        if not self._has_past_events:
            self._has_past_events = True
            state_stored_fields(self._inside.aspace, fields)
        for source in sources:
            offer_events(self._inside.aspace, source)
            self._histories.add_events(source, historian)

    def keep_conditions(self, keeper: ConditionKeeper) -> None:
        """Let clients acknowledge, confirm, comment on and refresh the conditions of a keeper."""
        self.conditions.keeper = keeper

    def add_condition(self, folder: ua.NodeId, condition: Callable[[], Condition]) -> None:
        """Expose a condition as nodes below an object, created on first access.

        Parameters
        ----------
        folder
            The condition's own object, of the condition's type, without children.
        condition
            Returns the state of the condition at that time.
        """
        added_at = self._added_at()

        async def make() -> None:
            self.conditions.nodes.make(condition(), added_at)

        self.add_later(folder, make)

    def let_emit(self, source: ua.NodeId, notifier: ua.NodeId | None = None) -> None:
        """Let clients subscribe to the events of an object.

        Parameters
        ----------
        source
            The object.
        notifier
            Object that gets a HasNotifier reference to the source; None: no object. The reference
            is hierarchical, so browsers show the source below the notifier, too.
        """
        aspace = self._inside.aspace
        own = aspace[source]
        if notifier is not None:
            kind, above = ua.NodeId(ua.ObjectIds.HasNotifier), aspace[notifier]
            above.references.append(reference(kind, own, forward=True))
            own.references.append(reference(kind, above, forward=False))
        emits = ua.DataValue(ua.Variant(_EMITS, ua.VariantType.Byte))
        own.attributes[ua.AttributeIds.EventNotifier].value = emits

    def refer_to_conditions(self, source: ua.NodeId, conditions: Iterable[ConditionKey]) -> None:
        """Add references from an object to its conditions, whose nodes need not exist yet."""
        self._inside.aspace[source].references.extend(references_to(conditions))

    def mark(self, variable: Variable, code: int) -> None:
        """Change the status of a variable's value, keeping value and source time."""
        held = self._inside.aspace.read_attribute_value(variable.id, ua.AttributeIds.Value)
        server_time = instant(self._clock.now())
        data = dataclasses.replace(
            held, StatusCode=ua.StatusCode(code), ServerTimestamp=server_time
        )
        self._write_data_value(variable.id, data)

    def mark_block(self, block: Block, code: int, columns: NDArray[np.intp] | None = None) -> None:
        """Change the status of a block's values, in the given columns or all; keep the rest."""
        block.take(block.marked(code, self._clock.now(), columns))

    def write_property(self, id_: ua.NodeId, value: ua.Variant) -> None:
        """Publish a property of the server."""
        now = instant(self._clock.now())
        self._write_data_value(id_, ua.DataValue(value, ua.StatusCode(), now, now))

    def _write_data_value(self, nodeid: ua.NodeId, data: ua.DataValue) -> None:
        if place := self._subscriptions.blocks.get(nodeid):
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

    def _trigger_event_of_asyncua(self, event: Any) -> None:  # noqa: ANN401 - asyncua's
        self.events.trigger(event_of_asyncua(event))
