"""What a hardened server is told before it starts."""

from dataclasses import dataclass, field
from pathlib import Path

from service.opcua.hardened.certificates import Pki
from service.opcua.hardened.users import UserStore


@dataclass(frozen=True)
class Limits:
    """What peers may cost; each limit with its unit, announced where OPC UA has a node for it.

    Attributes
    ----------
    connections, connections_per_host
        TCP connections, those without a session included.
    sessions, sessions_per_host
        Sessions, activated or not.
    handshake_seconds
        Time from connecting to an activated session.
    handshake_bytes, handshake_messages
        What a peer may send before its session is activated.
    message_bytes, chunks, chunk_bytes
        Size of one request, how many chunks it may come in, and the largest of them.
    unsent_bytes
        Answers waiting for a slow reader; past that it is disconnected.
    requests_per_second, request_burst
        Steady rate and burst of requests of one connection.
    subscriptions, subscriptions_per_session
        Subscriptions.
    monitored_items, monitored_items_per_subscription
        Monitored items.
    queue_size
        Largest queue of one monitored item, notifications.
    unacknowledged_messages
        Notification messages of one subscription kept for Republish.
    publish_requests
        Publish requests of one session that may wait.
    publishing_interval_ms, longest_publishing_interval_ms
        Shortest and longest publishing interval, ms.
    keep_alive_count, lifetime_count
        Largest revised counts of a subscription.
    session_timeout_ms
        Longest session time-out, ms.
    operations
        Operations (nodes, items, methods) of one request.
    references_per_node
        References that one Browse answers before it gives a continuation point.
    continuation_points
        Continuation points of one session.
    array_length, string_bytes, nesting
        Longest array, longest string and deepest nesting that are decoded.
    """

    connections: int = 100
    connections_per_host: int = 50
    sessions: int = 100
    sessions_per_host: int = 50
    handshake_seconds: float = 10.0
    handshake_bytes: int = 64 * 1024
    handshake_messages: int = 20
    message_bytes: int = 1024 * 1024
    chunks: int = 64
    chunk_bytes: int = 65_535
    unsent_bytes: int = 8 * 1024 * 1024
    requests_per_second: float = 500.0
    request_burst: float = 1_000.0
    subscriptions: int = 200
    subscriptions_per_session: int = 20
    monitored_items: int = 20_000
    monitored_items_per_subscription: int = 5_000
    queue_size: int = 10_000
    unacknowledged_messages: int = 100
    publish_requests: int = 50
    publishing_interval_ms: float = 50.0
    longest_publishing_interval_ms: float = 3_600_000.0
    keep_alive_count: int = 5_000
    lifetime_count: int = 15_000
    session_timeout_ms: float = 600_000.0
    operations: int = 1_000
    references_per_node: int = 1_000
    continuation_points: int = 10
    array_length: int = 100_000
    string_bytes: int = 256 * 1024
    nesting: int = 32


@dataclass(frozen=True)
class ServerSettings:
    """Identity, endpoint, security and limits of one server.

    Attributes
    ----------
    url
        Where to listen, e.g. ``opc.tcp://0.0.0.0:4841/valvemap/service/``; port 0 takes a free
        one.
    application_uri, application_name, product_uri
        Identity of this installation; the certificate names the first letter by letter.
    namespace_uri
        Namespace of the server's own nodes.
    pki
        Certificates; with None only the demo's endpoint without security is offered.
    users
        Who may log in.
    none_on_loopback
        Also offer SecurityPolicy None, with anonymous users as observers; only for 127.0.0.1
        and ::1.
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
    product_uri: str = "urn:valvemap"
    pki: Pki | None = None
    users: UserStore = field(default_factory=UserStore)
    none_on_loopback: bool = False
    anonymous_observer: bool = False
    host_names: tuple[str, ...] = ()
    limits: Limits = field(default_factory=Limits)
    cache: Path | None = None
