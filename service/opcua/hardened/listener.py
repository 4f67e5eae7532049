"""Everything behind one listening socket: connections, sessions, and what they share."""

import asyncio
import copy
import os
import secrets
import socket
from collections import Counter
from typing import Any
from urllib.parse import urlparse

from asyncua import ua
from cryptography.hazmat.primitives.asymmetric import rsa

from service.clock import Clock
from service.opcua.hardened.audit import Actor, Audit
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
_GUESSES_AT_ONCE = 1
_BACKLOG = 100
_ARRIVALS_BYTES = 64 * 1024
_ACCEPTED_AT_ONCE = 8  # asyncio accepts as many at a stretch as it is told the backlog is
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
        audit: Audit,
        *,
        anonymous_allowed: bool,
    ) -> None:
        self.limits = limits
        self.clock = clock
        self.users = users
        self.pki = pki
        self.sessions = sessions
        self.services = services
        self.audit = audit
        self.anonymous_allowed = anonymous_allowed
        self.turns = Turns()
        self.arrivals = memoryview(bytearray(_ARRIVALS_BYTES))  # emptied before the next arrive
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
        self._of_host: Counter[str] = Counter()
        self._openings: Counter[str] = Counter()  # in this second
        self._second = 0
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
        found = await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        family, _, _, _, address = found[0]
        # With the protocol named, asyncio sends without delay (TCP_NODELAY).
        listening = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
        try:
            if os.name == "posix":
                listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.bind(address)
            self._server = await loop.create_server(
                lambda: Connection(self), sock=listening, backlog=_ACCEPTED_AT_ONCE
            )
        except OSError:
            listening.close()
            raise
        listening.listen(_BACKLOG)
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
        limits, host = self.limits, connection.host
        second = int(self.clock.monotonic())
        if second != self._second:
            self._second = second
            self._openings.clear()
        self._openings[host] += 1
        if (
            len(self._connections) >= limits.connections
            or self._of_host[host] >= limits.connections_per_host
            or self._openings[host] > limits.connections_per_second
        ):
            self.refused_connections += 1
            _log.warning("%s: refused: too many connections", host)
            return False
        self._connections.add(connection)
        self._of_host[host] += 1
        return True

    def forget(self, connection: Connection) -> None:
        """Forget a connection that is gone."""
        if connection not in self._connections:
            return
        self._connections.discard(connection)
        self._of_host[connection.host] -= 1
        if not self._of_host[connection.host]:
            del self._of_host[connection.host]
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

    async def _reap_for_ever(self) -> None:
        while True:
            await asyncio.sleep(_REAP_S)
            try:
                self._reap()
            except Exception:  # noqa: BLE001 - it must go on for the others
                _log.exception("tidying up failed")

    def _reap(self) -> None:
        for session in self.sessions.drop_timed_out():
            self.audit.session_closed(Actor(session, session.host), timed_out=True)
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
