"""The hardened server: identity, endpoints, values; it is independent of its application."""

import asyncio
import dataclasses
import datetime as dt
import ipaddress
from collections.abc import Callable, Collection, Coroutine, Iterable, Sequence
from typing import Any, Self
from urllib.parse import urlparse

import numpy as np
from asyncua import Server, ua
from asyncua.server.address_space import AddressSpace, AttributeValue
from asyncua.server.internal_session import InternalSession
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from numpy.typing import ArrayLike, NDArray

from guarded_opcua.address_space.asyncua_server import AsyncuaServer
from guarded_opcua.address_space.attributes import Attributes
from guarded_opcua.address_space.blocks import Block
from guarded_opcua.address_space.browse import View
from guarded_opcua.address_space.declarations import Method, Value, Variable
from guarded_opcua.address_space.insertion import many_nodes, reference
from guarded_opcua.address_space.metadata import describe_namespace
from guarded_opcua.address_space.node_sets import import_node_set, refer, refer_back
from guarded_opcua.address_space.packed_nodes import is_below, make_later
from guarded_opcua.address_space.plain_values import as_variant
from guarded_opcua.address_space.removal import remove
from guarded_opcua.address_space.self_description import SelfDescription
from guarded_opcua.address_space.watchers import drive, notify
from guarded_opcua.audit import Audit
from guarded_opcua.binary.encoding import DTYPES, instant, nanoseconds
from guarded_opcua.clock import Clock, SystemClock
from guarded_opcua.conditions.calls import Conditions
from guarded_opcua.conditions.condition import Condition, ConditionKey
from guarded_opcua.conditions.keeper import ConditionKeeper
from guarded_opcua.conditions.nodes import ConditionNodes, references_to
from guarded_opcua.errors import CertificateError, ConfigurationError, ServerError
from guarded_opcua.history.aggregate_kinds import Aggregate
from guarded_opcua.history.events import MOST_EVENTS, EventHistorian
from guarded_opcua.history.historian import Historian
from guarded_opcua.history.reading import Histories
from guarded_opcua.lifecycle import Startable
from guarded_opcua.logs import bounded_logger
from guarded_opcua.monitoring.event_filter import event_of_asyncua, filter_of_fields
from guarded_opcua.security.certificates import (
    KEY_BITS,
    ensure_certificate,
    expiry_warning,
    load_certificate,
    make_certificate,
)
from guarded_opcua.security.login_queue import LoginQueue
from guarded_opcua.security.peer_certificates import PeerTrust
from guarded_opcua.sessions.services import Services
from guarded_opcua.sessions.session import Sessions
from guarded_opcua.settings import ServerSettings
from guarded_opcua.subscriptions.pace import Pace
from guarded_opcua.subscriptions.registry import Subscriptions
from guarded_opcua.transport.endpoints import offered_endpoints, offered_policies
from guarded_opcua.transport.fair_turns import FairTurns
from guarded_opcua.transport.listener import Listener
from guarded_opcua.transport.shared import Own, Shared, Traffic

_log = bounded_logger(__name__)

_EMITS = 1 << ua.EventNotifier.SubscribeToEvents
_REMEMBERS = 1 << ua.EventNotifier.HistoryRead

Update = tuple[Variable, Value, int, int]


@dataclasses.dataclass(frozen=True)
class ServerCounters:
    """Current sizes of a server, and its totals since the start."""

    sessions: int
    subscriptions: int
    monitored_items: int
    queued_notifications: int
    lost_notifications: int
    requests: int
    refused_requests: int
    refused_connections: int


class HardenedServer(Startable):
    """An OPC UA server with limits, PKI and users.

    Create it with :meth:`create`, add nodes, then use ``async with`` or call :meth:`start` and
    :meth:`stop`.

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
    announcements
        What the server says of itself, such as its ServiceLevel.
    """

    def __init__(self, settings: ServerSettings, clock: Clock | None = None) -> None:
        self.settings = settings
        self.namespace_index = 0
        self._clock = clock or SystemClock()
        self._inside = AsyncuaServer(settings.cache)
        self.ua = Server(iserver=self._inside)
        self._variables: dict[ua.NodeId, Variable] = {}
        self._methods: dict[ua.NodeId, Method] = {}
        self._port: int | None = None
        self._made_at: int | None = None  # when the lazy folder being populated was added
        limits, aspace = settings.limits, self._inside.aspace
        self._subscriptions = Subscriptions(aspace, limits, self._clock)
        self.events = self._subscriptions.events
        self._inside.hand_events_to(self._trigger_event_of_asyncua)
        self._sessions = Sessions(
            limits,
            self._clock,
            self._subscriptions.ledger,
            Pace(self._clock),
            self._subscriptions.end,
        )
        self._view = View(aspace, limits)
        self._attributes = Attributes(
            aspace,
            self._variables,
            self._methods,
            self._take_write,
            self.utc,
        )
        self._audit = Audit(
            settings.application_uri,
            self._subscriptions,
            self._clock,
            limits.audit_events_per_second,
        )
        self._histories = Histories(limits, aspace)
        self.conditions = Conditions(
            self._subscriptions, ConditionNodes(aspace, self._write_data_value), self._clock
        )
        self._has_history = self._has_past_events = False
        self._services = Services(
            limits,
            self._clock,
            self._attributes,
            self._view,
            self._subscriptions,
            self._histories,
            self.conditions,
            self._audit,
        )
        self.announcements = SelfDescription(
            aspace, self._write_data_value, self._clock, settings, self._summary
        )
        self._listener: Listener | None = None
        self._traffic = Traffic()

    @classmethod
    async def create(cls, settings: ServerSettings, clock: Clock | None = None) -> Self:
        """Create a server with its standard nodes; it does not listen yet.

        Raises
        ------
        ConfigurationError
            if the settings are inconsistent.
        """
        _check(settings)
        server = cls(settings, clock)
        await server.ua.init()
        await server.ua.set_application_uri(settings.application_uri)
        server.namespace_index = await server.namespace(settings.namespace_uri)
        describe_namespace(
            server.address_space,
            server.namespace_index,
            settings.namespace_uri,
            settings.namespace_version,
            settings.namespace_published,
        )
        return server

    @property
    def session(self) -> InternalSession:
        """The server's internal session, which has all permissions."""
        return self._inside.isession

    @property
    def address_space(self) -> AddressSpace:
        """All nodes."""
        return self._inside.aspace

    @property
    def url(self) -> str:
        """Endpoint URL of the server; with port 0, the port is known after the start."""
        parsed = urlparse(self.settings.url)
        port = parsed.port if self._port is None else self._port
        return parsed._replace(netloc=f"{_bracketed(parsed.hostname or '')}:{port}").geturl()

    @property
    def counters(self) -> ServerCounters:
        """The current counters."""
        return ServerCounters(
            sessions=len(self._sessions),
            subscriptions=len(self._subscriptions.by_number),
            monitored_items=self._subscriptions.item_count,
            queued_notifications=self._subscriptions.ledger.queued,
            lost_notifications=self._subscriptions.ledger.lost,
            requests=self._traffic.requests,
            refused_requests=self._traffic.refused_requests,
            refused_connections=self._traffic.refused_connections,
        )

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

    def refer(self, source: ua.NodeId, kind: int, target: ua.NodeId) -> None:
        """Add a forward reference from a node to another.

        The target gets the inverse reference from :meth:`refer_back`; for a lazy folder, call that
        when the folder is populated.
        """
        refer(self._inside.aspace, source, ua.NodeId(kind), target)

    def refer_back(self, source: ua.NodeId, kind: int, target: ua.NodeId) -> None:
        """Add the inverse reference from a node to another that refers to it."""
        refer_back(self._inside.aspace, source, ua.NodeId(kind), target)

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
            if variable.array or variable.type not in DTYPES:
                raise ServerError(f"{variable.id.Identifier}: histories are of scalar numbers")
            self._histories.add(variable, historian)
            attributes = self._inside.aspace[variable.id].attributes
            for of_level in (ua.AttributeIds.AccessLevel, ua.AttributeIds.UserAccessLevel):
                level = attributes[of_level].value.Value.Value | 1 << ua.AccessLevel.HistoryRead
                attributes[of_level].value = ua.DataValue(ua.Variant(level, ua.VariantType.Byte))
            historizing = ua.DataValue(ua.Variant(True, ua.VariantType.Boolean))  # noqa: FBT003
            attributes[ua.AttributeIds.Historizing].value = historizing

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
        aspace = self._inside.aspace
        filter_ = aspace[ua.NodeId(ua.ObjectIds.HistoricalEventFilter)]
        if not self._has_past_events:
            self._has_past_events = True
            kept = ua.Variant(filter_of_fields(fields), ua.VariantType.ExtensionObject)
            filter_.attributes[ua.AttributeIds.Value].value = ua.DataValue(kept)
            scalar = ua.DataValue(ua.Variant(int(ua.ValueRank.Scalar), ua.VariantType.Int32))
            filter_.attributes[ua.AttributeIds.ValueRank].value = scalar
        has_property = reference(ua.NodeId(ua.ObjectIds.HasProperty), filter_, forward=True)
        for source in sources:
            self._histories.add_events(source, historian)
            aspace[source].references.append(has_property)
            notifier = ua.DataValue(ua.Variant(_EMITS | _REMEMBERS, ua.VariantType.Byte))
            aspace[source].attributes[ua.AttributeIds.EventNotifier].value = notifier

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

    async def start(self) -> None:
        """Start listening.

        Raises
        ------
        ServerError
            if the address is in use or not local; the message names the endpoint.
        CertificateError
            if the certificate or key cannot be loaded or created.
        """
        settings = self.settings
        certificate, key = await asyncio.to_thread(_certificate, settings)
        if warning := expiry_warning(certificate):
            _log.warning("%s", warning)
        der = certificate.public_bytes(serialization.Encoding.DER)
        shared = Shared(
            limits=settings.limits,
            clock=self._clock,
            users=settings.users,
            trust=PeerTrust(settings.pki, self._clock, require_crl=settings.require_crl),
            sessions=self._sessions,
            services=self._services,
            audit=self._audit,
            own=Own(der, key, offered_policies(settings, certificate, key)),
            turns=FairTurns(self._clock),
            logins=LoginQueue(settings.users, self._clock),
            anonymous_allowed=settings.none_on_loopback or settings.anonymous_observer,
            gateways=settings.gateways,
            traffic=self._traffic,
        )
        listener = Listener(shared)
        self._view.forget_types()
        parsed = urlparse(settings.url)
        try:
            self._port = await listener.start(parsed.hostname or "", parsed.port or 0)
        except OSError as error:
            reason = error.strerror or str(error)
            raise ServerError(f"{settings.url}: cannot listen there: {reason}") from error
        self._listener = listener
        shared.offered.extend(offered_endpoints(settings, self.url, der))
        self.announcements.announce(
            tuple(Aggregate) if self._has_history else None,
            conditions=self.conditions.keeper is not None,
            past_events=MOST_EVENTS if self._has_past_events else 0,
        )
        self.announcements.start()
        if settings.none_on_loopback:
            _log.warning("%s: also open without security, on loopback (demo only)", self.url)

    async def stop(self) -> None:
        """Stop listening and close every session; safe to call twice."""
        listener, self._listener = self._listener, None
        if listener is not None:
            self.announcements.stop()
            await listener.stop()
            await self._inside.stop()

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

    def _summary(self) -> dict[str, int]:
        totals, traffic = self._sessions.totals, self._traffic
        intervals = {s.timing.interval_s for s in self._subscriptions.by_number.values()}
        return {
            "CurrentSessionCount": len(self._sessions),
            "CumulatedSessionCount": totals.created,
            "SecurityRejectedSessionCount": totals.refused_for_security,
            "RejectedSessionCount": totals.refused + totals.refused_for_security,
            "SessionTimeoutCount": totals.timed_out,
            "PublishingIntervalCount": len(intervals),
            "CurrentSubscriptionCount": len(self._subscriptions.by_number),
            "CumulatedSubscriptionCount": self._subscriptions.created,
            "SecurityRejectedRequestsCount": traffic.refused_for_security,
            "RejectedRequestsCount": traffic.refused_requests,
        }


def _check(settings: ServerSettings) -> None:
    parsed = urlparse(settings.url)
    try:
        complete = parsed.scheme == "opc.tcp" and parsed.hostname and parsed.port is not None
    except ValueError:
        complete = False
    if not complete:
        raise ConfigurationError(
            f"{settings.url}: an endpoint like opc.tcp://127.0.0.1:4840/path/ is needed"
        )
    if settings.none_on_loopback and parsed.hostname not in ("127.0.0.1", "::1"):
        raise ConfigurationError(
            f"{settings.url}: without security a server listens on 127.0.0.1 or ::1 only"
        )
    if settings.pki is None and not settings.none_on_loopback:
        raise ConfigurationError(f"{settings.url}: a server on the network needs a PKI folder")


def _certificate(settings: ServerSettings) -> tuple[x509.Certificate, rsa.RSAPrivateKey]:
    names = settings.host_names or ("localhost", "127.0.0.1")
    uri, name = settings.application_uri, settings.application_name
    if settings.pki is None:  # only encrypts passwords sent to the demo's unsecured endpoint
        key = rsa.generate_private_key(public_exponent=65537, key_size=KEY_BITS)
        return make_certificate(key, uri, names, name), key
    file_name = "".join(c if c.isalnum() else "-" for c in name)
    own = ensure_certificate(settings.pki, uri, names, file_name)
    loaded = serialization.load_pem_private_key(own.key.read_bytes(), None)
    if not isinstance(loaded, rsa.RSAPrivateKey):
        raise CertificateError(f"{own.key}: an RSA key is needed")
    return load_certificate(own.certificate), loaded


def _bracketed(host: str) -> str:
    try:
        return f"[{host}]" if ipaddress.ip_address(host).version == 6 else host
    except ValueError:
        return host
