"""The listening socket: admits connections, and closes those that exceed their time limits."""

import asyncio
import os
import socket
from collections.abc import Container
from functools import partial
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError

from guarded_opcua.admission import Admission
from guarded_opcua.audit import Actor
from guarded_opcua.logs import bounded_logger
from guarded_opcua.security.identity import still_accepted
from guarded_opcua.sessions.session import Session
from guarded_opcua.transport.connection import Connection
from guarded_opcua.transport.shared import Shared

_log = bounded_logger(__name__)
_REAP_S = 1.0
_BACKLOG = 4096  # connections that wait to be accepted: attackers must not fill the queue
_ACCEPTED_AT_ONCE = 8  # asyncio accepts as many connections per loop iteration as the backlog


class Listener:
    """Listens, admits connections, and closes those that exceed their time limits."""

    def __init__(self, shared: Shared) -> None:
        self._shared = shared
        limits = shared.limits
        self._connections: Admission[Connection] = Admission(
            shared.clock,
            limits.connections,
            limits.connections_per_host,
            limits.connections_per_second,
            lambda connection: (connection.progress, connection.since),
            self._logged_in,
            self._give_way,
        )
        self._server: asyncio.Server | None = None
        self._reaper: asyncio.Task[None] | None = None

    async def start(self, host: str, port: int) -> int:
        """Start listening; return the port.

        Raises
        ------
        OSError
        """
        loop = asyncio.get_running_loop()
        found = await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        family, _, _, _, address = found[0]
        # asyncio sets TCP_NODELAY only if the protocol is given explicitly.
        listening = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
        try:
            if os.name == "posix":
                listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.bind(address)
            self._server = await loop.create_server(
                lambda: Connection(self._shared, self), sock=listening, backlog=_ACCEPTED_AT_ONCE
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
        for session in self._shared.sessions:
            self._shared.sessions.close(session, code=ua.StatusCodes.BadServerHalted)
        for connection in self._connections:
            connection.transport.close()  # flushes the send buffer
        if self._server is not None:
            await self._server.wait_closed()
        await asyncio.sleep(0)

    def admit(self, connection: Connection) -> bool:
        """Return whether a new connection is admitted, evicting another one if needed.

        The evicted connection belongs to the address with the most connections. It is the one with
        the least handshake progress, the oldest first. Connections with an active session are not
        evicted.
        """
        if self._connections.admit(connection, connection.host):
            return True
        self._shared.traffic.refused_connections += 1
        _log.warning("%s: refused: too many connections", connection.host)
        return False

    def forget(self, connection: Connection) -> None:
        """Remove a closed connection, and unbind its sessions."""
        if self._connections.leave(connection):
            self._shared.sessions.lose_line(connection)

    def sent(self, connection: Connection) -> None:
        """Disconnect the slowest reader if the send buffers of all connections are too large."""
        if connection.writable:
            return
        total = sum(map(_unsent, self._connections))
        if total > self._shared.limits.unsent_bytes:
            slowest = max(self._connections, key=_unsent)
            _log.warning("%s: disconnected: reads too slowly", slowest.host)
            slowest.transport.abort()

    def _logged_in(self, _newcomer: object = None) -> Container[Any]:
        """Return the connections with an active session."""
        return {session.line for session in self._shared.sessions if session.active}

    def _give_way(self, connection: Connection) -> None:
        _log.warning("%s: disconnected: gives way to others", connection.host)
        self._shared.sessions.lose_line(connection)
        connection.transport.abort()

    async def _reap_for_ever(self) -> None:
        while True:
            await self._shared.clock.sleep(_REAP_S)
            try:
                self._reap()
                await self._part_with_the_distrusted()
            except Exception:  # noqa: BLE001 - the reaper must survive a failure
                _log.exception("tidying up failed")

    def _reap(self) -> None:
        for session in self._shared.sessions.drop_timed_out():
            self._shared.audit.session_closed(Actor(session, session.host), timed_out=True)
        limits, now = self._shared.limits, self._shared.clock.monotonic()
        logged_in = self._logged_in()
        for connection in self._connections:
            blocked = connection.blocked_since
            if blocked is not None and now - blocked > limits.slow_reader_seconds:
                _log.warning("%s: disconnected: reads too slowly", connection.host)
                connection.transport.abort()
            elif connection.channel.expired:
                connection.fail(ua.StatusCodes.BadSecureChannelClosed, "channel not renewed")
            elif connection not in logged_in and now - connection.idle_since > (
                limits.handshake_seconds
            ):
                connection.fail(ua.StatusCodes.BadTimeout, "nobody logged in")

    async def _part_with_the_distrusted(self) -> None:
        """Close channels and sessions whose certificate or user is no longer accepted.

        It yields between two checks: one takes 10 ms with a revocation list of 50,000 entries.
        """
        self._shared.users.refresh()
        if not self._shared.trust.look_again():
            return
        for connection in self._connections:
            await asyncio.sleep(0)
            if connection.transport.is_closing():
                continue
            try:
                connection.channel.check_again()
            except ServiceError as error:
                for session in self._shared.sessions:
                    if session.line is connection:
                        self._end(session, error.code)
                connection.fail(error.code, "its certificate is accepted no more")
        for session in self._shared.sessions:
            await asyncio.sleep(0)
            principal = session.principal
            if principal is None or session.closed:
                continue
            refused = partial(self._shared.audit.certificate_refused, session.host)
            if not still_accepted(principal, self._shared.users, self._shared.trust, refused):
                _log.warning("%s: session of %s ended: accepted no more", session.host, principal)
                self._end(session, ua.StatusCodes.BadIdentityTokenRejected)

    def _end(self, session: Session, code: int) -> None:
        self._shared.audit.session_closed(Actor(session, session.host))
        self._shared.sessions.close(session, code=code)


def _unsent(connection: Connection) -> int:
    """Bytes in the send buffer."""
    return connection.transport.get_write_buffer_size()
