"""Everything behind one listening socket: connections, sessions, and what they share."""

import asyncio
import copy
import secrets
from collections import Counter, deque
from typing import Any
from urllib.parse import urlparse

from asyncua import ua
from cryptography.hazmat.primitives.asymmetric import rsa

from service.clock import Clock
from service.opcua.hardened.certificates import Pki
from service.opcua.hardened.connection import Connection
from service.opcua.hardened.logs import bounded_logger
from service.opcua.hardened.services import Services
from service.opcua.hardened.session import Sessions
from service.opcua.hardened.settings import Limits
from service.opcua.hardened.turns import Turns
from service.opcua.hardened.users import UserStore

_log = bounded_logger(__name__)
_REAP_S = 1.0
_GUESSES_AT_ONCE = 2
_BACKLOG = 100
_SECURITY_CODES = {
    getattr(ua.StatusCodes, name)
    for name in vars(ua.StatusCodes)
    if name.startswith(("BadCertificate", "BadSecurity", "BadIdentityToken", "BadUser"))
}


class Listener:
    """Admits connections, keeps them apart, and ends those that overstay."""

    def __init__(
        self,
        limits: Limits,
        clock: Clock,
        users: UserStore,
        pki: Pki | None,
        sessions: Sessions,
        services: Services,
        *,
        anonymous_allowed: bool,
    ) -> None:
        self.limits = limits
        self.clock = clock
        self.users = users
        self.pki = pki
        self.sessions = sessions
        self.services = services
        self.anonymous_allowed = anonymous_allowed
        self.turns = Turns()
        self.guesses = asyncio.Semaphore(_GUESSES_AT_ONCE)
        self.policies: list[Any] = []
        self.certificate_der = b""
        self.key: rsa.RSAPrivateKey
        self.requests = 0
        self.refused_requests = 0
        self.refused_for_security = 0
        self.refused_connections = 0
        self._endpoints: list[ua.EndpointDescription] = []
        self._connections: set[Connection] = set()
        self._openings: deque[tuple[float, str]] = deque(maxlen=1_000)
        self._channel_id = secrets.randbits(16)
        self._server: asyncio.Server | None = None
        self._reaper: asyncio.Task[None] | None = None

    def get_new_channel_id(self) -> int:
        """Return the number of a new channel."""
        self._channel_id = self._channel_id % 0xFFFF_FFFE + 1
        return self._channel_id

    async def start(self, host: str, port: int) -> int:
        """Listen; return the port.

        Raises
        ------
        OSError
        """
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(
            lambda: Connection(self), host, port, backlog=_BACKLOG
        )
        self._reaper = asyncio.create_task(self._reap_for_ever())
        return int(self._server.sockets[0].getsockname()[1])

    async def stop(self) -> None:
        """Stop listening and close every session and connection."""
        if self._reaper is not None:
            self._reaper.cancel()
        if self._server is not None:
            self._server.close()
        for session in self.sessions:
            self.sessions.close(session, code=ua.StatusCodes.BadServerHalted)
        for connection in list(self._connections):
            connection.close()
        if self._server is not None:
            await self._server.wait_closed()
        await asyncio.sleep(0)

    def announce(self, endpoints: list[ua.EndpointDescription]) -> None:
        """Set what GetEndpoints answers."""
        self._endpoints = endpoints

    def endpoints(self, reached_as: str | None) -> list[ua.EndpointDescription]:
        """Return the endpoints under the host and port by which the peer reaches us."""
        if reached_as is None:
            return self._endpoints
        found = []
        for endpoint in self._endpoints:
            own = copy.copy(endpoint)
            own.EndpointUrl = _with_netloc(own.EndpointUrl, reached_as)
            own.Server = copy.copy(own.Server)
            own.Server.DiscoveryUrls = [own.EndpointUrl]
            found.append(own)
        return found

    def admit(self, connection: Connection) -> bool:
        """Take a new connection, unless there are too many of them."""
        limits, now = self.limits, self.clock.monotonic()
        of_host = sum(other.host == connection.host for other in self._connections)
        self._openings.append((now, connection.host))
        recent = sum(host == connection.host and now - at < 1.0 for at, host in self._openings)
        if (
            len(self._connections) >= limits.connections
            or of_host >= limits.connections_per_host
            or recent > limits.connections_per_second
        ):
            self.refused_connections += 1
            _log.warning("%s: refused: too many connections", connection.host)
            return False
        self._connections.add(connection)
        return True

    def forget(self, connection: Connection) -> None:
        """Forget a connection that is gone."""
        self._connections.discard(connection)
        self.sessions.lose_line(connection)

    def count_refusal(self, code: int) -> None:
        """Count a request that was answered with a fault."""
        self.refused_requests += 1
        self.refused_for_security += code in _SECURITY_CODES

    def sent(self, connection: Connection) -> None:
        """Note that something was sent; the slowest reader goes if all hold too much."""
        if connection.writable:
            return
        total = sum(other.unsent for other in self._connections)
        if total > self.limits.unsent_bytes:
            slowest = max(self._connections, key=lambda other: other.unsent)
            _log.warning("%s: disconnected: reads too slowly", slowest.host)
            slowest.abort()

    @property
    def connections(self) -> Counter[str]:
        """How many connections each host has."""
        return Counter(connection.host for connection in self._connections)

    async def _reap_for_ever(self) -> None:
        while True:
            await asyncio.sleep(_REAP_S)
            try:
                self._reap()
            except Exception:  # noqa: BLE001 - it must go on for the others
                _log.exception("tidying up failed")

    def _reap(self) -> None:
        self.sessions.drop_timed_out()
        limits, now = self.limits, self.clock.monotonic()
        lines = {id(session.line) for session in self.sessions if session.active}
        for connection in list(self._connections):
            blocked = connection.blocked_since
            if blocked is not None and now - blocked > limits.slow_reader_seconds:
                _log.warning("%s: disconnected: reads too slowly", connection.host)
                connection.abort()
            elif connection.channel.expired:
                connection.fail(ua.StatusCodes.BadSecureChannelClosed, "channel not renewed")
            elif id(connection) not in lines and now - connection.idle_since > (
                limits.handshake_seconds
            ):
                connection.fail(ua.StatusCodes.BadTimeout, "nobody logged in")


def _with_netloc(url: str, netloc: str) -> str:
    return urlparse(url)._replace(netloc=netloc).geturl()
