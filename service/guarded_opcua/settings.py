"""Identity, endpoints and limits of a guarded server."""

import datetime as dt
from dataclasses import dataclass, field
from pathlib import Path

from guarded_opcua.security.certificates import Pki
from guarded_opcua.security.users import UserStore


@dataclass(frozen=True)
class Limits:
    """What peers may cost; announced where OPC UA has a node for it.

    Attributes
    ----------
    reserved_share
        Share of sessions, subscriptions, monitored items, and items of one node, that is kept for
        users with the role Operator or above.
    connections, connections_per_host, connections_per_second
        TCP connections, those without a session included; the last one by host.
    sessions, sessions_per_host
        Sessions, logged in or not; where there are too many, an unused one gives way.
    handshake_seconds, handshake_bytes, handshake_messages
        From connecting to being logged in.
    message_bytes, chunks, chunk_bytes
        Size of one request, how many chunks it may come in, and the largest of them.
    elements, array_length, string_bytes, nesting
        What one request may hold: elements that are decoded one by one, numbers in one array,
        bytes in one string, depth.
    response_bytes
        Largest response.
    unsent_bytes_per_connection, unsent_bytes, slow_reader_seconds
        What may wait for a peer to read it: more, and the peer is answered no more; for longer,
        or more in all, and it is disconnected.
    requests_per_second, request_burst
        Steady rate and burst of requests of one connection; faster ones wait. Each 16 KiB of
        request or response count as one more. A rate that could not follow the shortest
        publishing interval is raised, see ``allowed_requests_per_second``.
    turn_s
        After so long a request lets others go first, s.
    operations, method_calls, history_reads
        Operations (nodes, items) of one request; methods, and histories, of one request.
    history_values, history_continuation_points
        Values of all histories in one response; histories of one session that are read in part.
    references_per_node, continuation_points
        References that one Browse answers at once; continuation points of one session.
    subscriptions, subscriptions_per_session
        Subscriptions.
    monitored_items, monitored_items_per_subscription
        Monitored items.
    event_items
        Monitored items that monitor events: each costs with every event of its object.
    links_per_subscription
        Links by which items of a subscription trigger others: each costs with every message.
    monitored_items_per_node, monitored_items_per_node_and_session
        Monitored items on one node: each costs with every change of it.
    queue_size, event_queue_size, queued_notifications
        Largest queue of one monitored item; notifications in all queues together.
    notifications_per_publish
        Most notifications in one publish response.
    unacknowledged_messages, unacknowledged_bytes
        Messages of one subscription, and bytes of all, that are kept for Republish.
    publish_requests
        Publish requests of one session that may wait.
    publishing_interval_ms, longest_publishing_interval_ms
        Shortest and longest publishing interval, ms. A sampling interval that is shorter means
        every change.
    keep_alive_count, lifetime_count, longest_lifetime_s
        Largest revised counts of a subscription, and longest time without publish requests.
    audit_events_per_second
        Audit events that security administrators hear of; a burst may be five times that.
    session_timeout_ms, shortest_session_timeout_ms
        Longest and shortest session time-out, ms.
    """

    reserved_share: float = 0.1
    connections: int = 100
    connections_per_host: int = 50
    connections_per_second: int = 200
    sessions: int = 100
    sessions_per_host: int = 50
    handshake_seconds: float = 10.0
    handshake_bytes: int = 64 * 1024
    handshake_messages: int = 20
    message_bytes: int = 512 * 1024
    chunks: int = 64
    chunk_bytes: int = 65_536
    elements: int = 5_000
    array_length: int = 100_000
    string_bytes: int = 64 * 1024
    nesting: int = 16
    response_bytes: int = 4 * 1024 * 1024
    unsent_bytes_per_connection: int = 1024 * 1024
    unsent_bytes: int = 32 * 1024 * 1024
    slow_reader_seconds: float = 30.0
    requests_per_second: float = 500.0
    request_burst: float = 1_000.0
    turn_s: float = 0.002
    operations: int = 1_000
    method_calls: int = 100
    history_reads: int = 100
    history_values: int = 20_000
    history_continuation_points: int = 100
    references_per_node: int = 1_000
    continuation_points: int = 10
    subscriptions: int = 200
    subscriptions_per_session: int = 20
    monitored_items: int = 20_000
    monitored_items_per_subscription: int = 10_000
    event_items: int = 500
    links_per_subscription: int = 1_000
    monitored_items_per_node: int = 50
    monitored_items_per_node_and_session: int = 5
    queue_size: int = 10_000
    event_queue_size: int = 1_000
    queued_notifications: int = 200_000
    notifications_per_publish: int = 10_000
    unacknowledged_messages: int = 100
    unacknowledged_bytes: int = 32 * 1024 * 1024
    publish_requests: int = 50
    publishing_interval_ms: float = 50.0
    longest_publishing_interval_ms: float = 3_600_000.0
    keep_alive_count: int = 5_000
    lifetime_count: int = 15_000
    longest_lifetime_s: float = 3_600.0
    audit_events_per_second: float = 100.0
    session_timeout_ms: float = 600_000.0
    shortest_session_timeout_ms: float = 5_000.0

    @property
    def allowed_requests_per_second(self) -> float:
        """Rate at which a client can ask for every publishing of some subscriptions."""
        return max(self.requests_per_second, 4_000.0 / self.publishing_interval_ms)


@dataclass(frozen=True)
class Product:
    """What a server says of the software that it is."""

    uri: str = ""
    manufacturer: str = ""
    version: str = ""


@dataclass(frozen=True)
class ServerSettings:
    """Identity, endpoint, security and limits of one server.

    Attributes
    ----------
    url
        Where to listen, e.g. ``opc.tcp://0.0.0.0:4840/plant/``; port 0 takes a free
        one.
    application_uri, application_name
        Identity of this installation; the certificate names the first letter by letter.
    product
        What software it is.
    namespace_uri, namespace_version, namespace_published
        Namespace of the server's own nodes; version and date of the model behind it.
    pki
        Certificates; with None only the demo's endpoint without security is offered.
    require_crl
        Refuse certificates of an authority without a valid revocation list. Those that are
        self-signed and trusted by themselves need none.
    users
        Who may log in.
    none_on_loopback
        Also offer SecurityPolicy None, with anonymous users as observers; only for 127.0.0.1
        and ::1.
    gateways
        Application URIs of clients by way of which users log in, e.g. a web page. The AuditEntryId
        of their ActivateSession is the address that the user came from, for the lock-out. A channel
        without security proves no URI: there, any peer on this machine can name addresses.
    anonymous_observer
        Let anonymous users observe on the secured endpoints too.
    host_names
        Names under which peers reach the server; announced and certified.
    limits
        What peers may cost.
    cache
        Folder for the parsed standard address space; None takes the user's cache folder.
    """

    url: str
    application_uri: str
    application_name: str
    namespace_uri: str
    namespace_version: str = "1.0.0"
    namespace_published: dt.datetime = dt.datetime(2026, 1, 1, tzinfo=dt.UTC)
    product: Product = Product()
    pki: Pki | None = None
    require_crl: bool = True
    users: UserStore = field(default_factory=UserStore)
    none_on_loopback: bool = False
    gateways: frozenset[str] = frozenset()
    anonymous_observer: bool = False
    host_names: tuple[str, ...] = ()
    limits: Limits = field(default_factory=Limits)
    cache: Path | None = None
