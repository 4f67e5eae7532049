"""A connection to an OPC UA server: channel and session. Every failure is a typed error."""

import asyncio
import contextlib
import ipaddress
import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from urllib.parse import urlsplit

from asyncua import Client, ua
from asyncua.crypto import security_policies

from guarded_opcua.security.certificate_rules import CertificateRefused
from valvemap.errors import SourceRejected
from valvemap.opcua_client.session import BatchSession
from valvemap.opcua_client.source_errors import source_errors
from valvemap.opcua_client.source_settings import Security, SourceSettings
from valvemap.opcua_client.transport import BoundedClient
from valvemap.opcua_client.trusted_server import TrustedServer, secure

_log = logging.getLogger(__name__)

_SESSION_TIMEOUT_MS = 120_000
_CHANNEL_LIFETIME_MS = 3_600_000
_FAREWELL_S = 2.0
_LOOK_AT_TRUST_S = 1.0
_SHORTEST_RENEWAL_S = 5.0  # a channel with a shorter lifetime is renewed too late


@dataclass(frozen=True)
class OperationLimits:
    """The maximum number of operations that a server accepts in one request."""

    nodes_per_read: int
    items_per_call: int


class Connection:
    """An open channel and session; made by :func:`open_connection`, used once."""

    def __init__(
        self,
        settings: SourceSettings,
        client: Client,
        session: BatchSession,
        server: TrustedServer | None,
        *,
        resumed: bool,
    ) -> None:
        self.resumed = resumed
        self.settings = settings
        self.session = session
        self.limits: OperationLimits | None = None  # not read yet
        self.types: dict[object, object] = {}  # data types, as far as read
        self._client = client
        self._server = server
        self._tasks = [asyncio.create_task(self._renew_for_ever())]
        if server is not None:
            self._tasks.append(asyncio.create_task(self._watch_trust(server)))

    @contextlib.contextmanager
    def errors(self, doing: str) -> Iterator[None]:
        """Convert every exception of the block to SourceLost or SourceRejected."""
        with source_errors(self.settings.url, doing):
            yield

    @property
    def ticket(self) -> "Ticket":
        """The data needed to resume the session over another connection."""
        client = self._client
        return Ticket(
            self.session.authentication_token,
            client._server_nonce,  # noqa: SLF001 - a private seam of asyncua
            tuple(client._policy_ids),  # noqa: SLF001
            client.security_policy.peer_certificate,
        )

    async def hang_up(self) -> None:
        """Close the socket only: the session and its subscriptions stay at the server."""
        await self._end_tasks()
        self._client.disconnect_socket()

    async def close(self) -> None:
        """Close the session and the channel if the server still responds, then the socket."""
        await self._end_tasks()
        client = self._client.uaclient
        with contextlib.suppress(OSError, TimeoutError, ua.UaError, asyncio.InvalidStateError):
            async with asyncio.timeout(_FAREWELL_S):
                if client.protocol is not None and not client.protocol.is_closed:
                    await self.session.close_session(delete_subscriptions=True)
                    await client.close_secure_channel()
        self._client.disconnect_socket()

    async def _end_tasks(self) -> None:
        """Cancel our tasks; keep asyncua's tasks from blocking the closing requests."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._client.uaclient.request_disconnect()
        self._client.uaclient.pre_request_hook = None

    async def _renew_for_ever(self) -> None:
        """Renew the channel's keys after three quarters of their life (Part 4, 5.6.2)."""
        while True:
            lifetime_s = 1e-3 * self._client.secure_channel_timeout
            await asyncio.sleep(max(0.75 * lifetime_s, _SHORTEST_RENEWAL_S))
            if self._server is not None and not self._is_trusted(self._server.check):
                return
            await self._client.open_secure_channel(renew=True)
            self._client.uaclient.revolve_security_token()

    async def _watch_trust(self, server: TrustedServer) -> None:
        """Disconnect from a server whose certificate is no longer accepted."""
        while True:
            await asyncio.sleep(_LOOK_AT_TRUST_S)
            if server.trust.look_again() and not self._is_trusted(server.check_again):
                return

    def _is_trusted(self, check: Callable[[], object]) -> bool:
        try:
            check()
        except CertificateRefused as refused:
            _log.warning("%s: disconnected: %s", self.settings.url, refused)
            self._client.disconnect_socket()
            return False
        return True


@dataclass(frozen=True)
class Ticket:
    """The data needed to resume a session: secret token, last nonce, user token policies.

    ``certificate`` is the server's certificate (DER), used to encrypt the password.
    """

    token: ua.NodeId = field(repr=False)
    nonce: bytes | None = field(repr=False)
    policies: tuple[ua.UserTokenPolicy, ...]
    certificate: bytes | None = field(repr=False)


async def open_connection(settings: SourceSettings, ticket: Ticket | None = None) -> Connection:
    """Connect, authenticate, and check the server's certificate.

    With a ``ticket`` its session is resumed if the server still has it; otherwise a new session is
    created.

    Raises
    ------
    SourceLost, SourceRejected, CertificateError
    """
    client = Client(settings.url, timeout=settings.timeout_s)
    client.name = client.description = "valvemap service"
    client.product_uri = "urn:valvemap"
    client.session_timeout = _SESSION_TIMEOUT_MS
    client.secure_channel_timeout = _CHANNEL_LIFETIME_MS
    transport = BoundedClient(settings.timeout_s)
    transport.pre_request_hook = client.uaclient.pre_request_hook
    transport.session = session = BatchSession(transport, settings.on_behalf_of)
    client.uaclient = transport
    if settings.user is not None:
        client.set_user(settings.user)
        client.set_password(settings.password or "")
    with source_errors(settings.url, "connecting"):
        try:
            async with asyncio.timeout(4 * settings.timeout_s):
                server = await secure(client, settings)
                await client.connect_socket()
                await client.send_hello()
                with source_errors(settings.url, _opening(settings)):
                    await client.open_secure_channel()
                resumed = ticket is not None and await _resume(client, session, settings, ticket)
                if not resumed:
                    await client.create_session()
                    _check_password_travels_safely(client, settings)
                    await client.activate_session(settings.user, settings.password)
        except BaseException:
            client.disconnect_socket()
            raise
    return Connection(settings, client, session, server, resumed=resumed)


async def _resume(
    client: Client, session: BatchSession, settings: SourceSettings, ticket: Ticket
) -> bool:
    """Resume a session; return whether the server still had it.

    Private seams of asyncua: ``Client._server_nonce``, ``_policy_ids``.
    """
    client._server_nonce = ticket.nonce  # noqa: SLF001
    client._policy_ids = list(ticket.policies)  # noqa: SLF001
    shown = client.security_policy.peer_certificate
    if not shown:
        client.security_policy.peer_certificate = ticket.certificate
    await session.resume(ticket.token)
    _check_password_travels_safely(client, settings)
    try:
        await client.activate_session(settings.user, settings.password)
    except ua.UaStatusCodeError as error:
        if error.code in {ua.StatusCodes.BadConnectionClosed, ua.StatusCodes.BadTimeout}:
            raise
    except (ValueError, TypeError, LookupError, AttributeError):
        pass  # the data of the old session are invalid now
    else:
        return True
    session.reset_authentication_token()
    client.security_policy.peer_certificate = shown
    return False


def _opening(settings: SourceSettings) -> str:
    """Describe the step in which the server sees our certificate; some servers just disconnect."""
    if settings.security is Security.NONE:
        return "opening the channel"
    return "opening the secure channel (does the server trust our certificate?)"


def _check_password_travels_safely(client: Client, settings: SourceSettings) -> None:
    if settings.user is None or settings.security is not Security.NONE:
        return
    policy = client.server_policy(ua.UserTokenType.UserName).SecurityPolicyUri
    in_the_clear = not policy or policy == security_policies.SecurityPolicyNone.URI
    if in_the_clear and not _is_this_host(urlsplit(settings.url).hostname or ""):
        raise SourceRejected(
            f"{settings.url}: the password of {settings.user} would travel in the clear; "
            f"choose security {Security.BASIC256_SHA256} or {Security.AES256_SHA256_RSA_PSS}"
        )


def _is_this_host(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
