"""Identity, endpoints and limits of a hardened server."""

import datetime as dt
from dataclasses import dataclass, field
from pathlib import Path

from guarded_opcua.security.pki_folders import Pki
from guarded_opcua.security.users import UserStore


@dataclass(frozen=True)
class Limits:
    """Resource limits of peers; announced where OPC UA defines a node for them.

    Attributes
    ----------
    reserved_share
        Share of sessions, subscriptions, monitored items, and items of one node, that is reserved
        for users with the role Operator or above.
    connections, connections_per_host, connections_per_second
        TCP connections, with or without a session; the last one is per host.
    sessions, sessions_per_host
        Sessions, activated or not; at the limit, an unused one is closed for a new one.
    handshake_seconds, handshake_bytes, handshake_messages
        Limits from connecting until ActivateSession.
    message_bytes, chunks, chunk_bytes
        Size of one request, number of its chunks, size of one chunk.
    elements, array_length, string_bytes, nesting
        Content of one request: elements that are decoded one by one, numbers in one array, bytes in
        one string, nesting depth.
    response_bytes
        Largest response.
    unsent_bytes_per_connection, unsent_bytes, slow_reader_seconds
        Bytes in the send buffers. Above the limit per connection, the server stops answering the
        peer. A peer is disconnected if this lasts longer than ``slow_reader_seconds`` or if the
        total is exceeded.
    requests_per_second, request_burst
        Steady rate and burst of requests of one connection; requests beyond them are delayed. Each
        16 KiB of request or response add one request. A rate too low for the shortest publishing
        interval is raised, see ``allowed_requests_per_second``.
    turn_s
        Processor time after which a request yields to other connections, s.
    operations, method_calls, history_reads
        Operations (nodes, items) of one request; methods, and histories, of one request.
    history_values, history_continuation_points
        Values of all histories in one response; continuation points of HistoryRead per session.
    references_per_node, continuation_points
        References of one Browse result; continuation points of Browse per session.
    subscriptions, subscriptions_per_session
        Subscriptions.
    monitored_items, monitored_items_per_subscription
        Monitored items.
    event_items
        Event items: each costs processor time with every event of its object.
    links_per_subscription
        Triggering links of a subscription: each costs processor time with every message.
    monitored_items_per_node, monitored_items_per_node_and_session
        Monitored items on one node: each costs processor time with every change.
    queue_size, event_queue_size, queued_notifications
        Largest queue of one monitored item; notifications in all queues together.
    notifications_per_publish
        Most notifications in one publish response.
    unacknowledged_messages, unacknowledged_bytes
        Messages of one subscription, and bytes of all subscriptions, kept for Republish.
    publish_requests
        Queued publish requests of one session.
    publishing_interval_ms, longest_publishing_interval_ms
        Shortest and longest publishing interval, ms. A shorter sampling interval is revised to 0:
        every change is reported.
    keep_alive_count, lifetime_count, longest_lifetime_s
        Largest revised counts of a subscription, and longest time without publish requests.
    audit_events_per_second
        Rate of audit events, 1/s; a burst may have five times as many.
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
        """Request rate, raised to serve publish requests at the shortest publishing interval."""
        return max(self.requests_per_second, 4_000.0 / self.publishing_interval_ms)


@dataclass(frozen=True)
class Product:
    """Software identity in the server's BuildInfo."""

    uri: str = ""
    manufacturer: str = ""
    version: str = ""


@dataclass(frozen=True)
class ServerSettings:
    """Identity, endpoint, security and limits of one server.

    Attributes
    ----------
    url
        Endpoint URL, e.g. ``opc.tcp://0.0.0.0:4840/plant/``; port 0 selects a free port.
    application_uri, application_name
        Identity of this installation; the certificate contains exactly this application URI.
    product
        Software identity.
    namespace_uri, namespace_version, namespace_published
        Namespace of the server's nodes; version and publication date of its model.
    pki
        Certificate folders; None: only the demo's endpoint without security is offered.
    require_crl
        Refuse certificates of an authority without a valid revocation list. Trusted self-signed
        certificates need none.
    users
        Accounts of the users.
    none_on_loopback
        Also offer SecurityPolicy None, with anonymous users as observers; only for 127.0.0.1
        and ::1.
    gateways
        Application URIs of clients that log users in on their behalf, e.g. a web page. For the
        lock-out, the AuditEntryId of their ActivateSession is the address of the user. A channel
        without security does not prove the URI, so any local peer can claim addresses there.
    anonymous_observer
        Grant anonymous users the role Observer on the secured endpoints, too.
    host_names
        Host names of the server, in its endpoints and its certificate.
    limits
        Resource limits of peers.
    cache
        Cache folder for the parsed standard address space; None: the user's cache folder.
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
