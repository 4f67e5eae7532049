"""A connection to an OPC UA server: channel, session, security. Every failure is a typed error."""

import asyncio
import contextlib
import ipaddress
import logging
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from urllib.parse import urlsplit

from asyncua import Client, ua
from asyncua.crypto import security_policies, uacrypto
from cryptography import x509
from cryptography.hazmat.primitives import serialization

from guarded_opcua import CertificateError
from guarded_opcua.security.certificate_rules import CertificateRefused, Use, first_certificate
from guarded_opcua.security.certificates import (
    OwnCertificate,
    Pki,
    expiry_warning,
    load_certificate,
    thumbprint,
)
from guarded_opcua.security.peer_certificates import (
    PeerTrust,
    application_uris,
    check_host_name,
)
from valvemap.errors import ConfigurationError, SourceLost, SourceRejected
from valvemap.foreign_text import printable
from valvemap.opcua_client.responses import Senseless
from valvemap.opcua_client.session import BatchSession
from valvemap.opcua_client.transport import BoundedClient

_log = logging.getLogger(__name__)
_DER = serialization.Encoding.DER

_SESSION_TIMEOUT_MS = 120_000
_CHANNEL_LIFETIME_MS = 3_600_000
_FAREWELL_S = 2.0
_LOOK_AT_TRUST_S = 1.0
_SHORTEST_RENEWAL_S = 5.0  # a channel with a shorter lifetime is renewed too late
_LINE = 300  # characters of a server's wording


class Security(StrEnum):
    """How a connection is protected; all but NONE sign and encrypt."""

    NONE = "None"
    BASIC256_SHA256 = "Basic256Sha256"
    AES256_SHA256_RSA_PSS = "Aes256Sha256RsaPss"


_POLICIES: dict[Security, type[security_policies.SecurityPolicy]] = {
    Security.BASIC256_SHA256: security_policies.SecurityPolicyBasic256Sha256,
    Security.AES256_SHA256_RSA_PSS: security_policies.SecurityPolicyAes256Sha256RsaPss,
}


@dataclass(frozen=True)
class SourceSettings:
    """Address, security and subscription settings of one OPC UA server.

    Attributes
    ----------
    url
        E.g. ``opc.tcp://127.0.0.1:4840/valvemap/rig/``.
    security
        Protection of the connection.
    pki, own
        Trust store and our certificate; required unless ``security`` is NONE.
    user, password
        Credentials; anonymous if ``user`` is None. The password is left out of ``repr`` and is
        never sent unencrypted, except to the loopback interface.
    on_behalf_of
        Address of the peer for which this client logs in; the server attributes failed logins to
        it.
    check_host_name
        Whether the server's certificate must name the host of ``url``.
    require_crl
        Whether the CA that issued the server's certificate needs a valid revocation list.
    application_uri
        Our application URI; None: taken from the certificate.
    publishing_interval_ms
        Requested publishing interval.
    sampling_interval_ms
        Requested sampling interval of a node; 0 = on every change.
    queue_size
        Requested queue size of a monitored item, in values.
    keep_alive_s
        Requested keep-alive time. Three missing keep-alives mean that the connection is lost.
    timeout_s
        Timeout of connecting and of every request.
    publish_requests
        Number of publish requests in flight.
    buffer_limit
        Changes buffered until ``receive`` returns them. Overflow policy: *back-pressure*. At the
        limit no further publish request is sent, so the server's queues fill. The values they drop
        are counted in ``counters.overflows``.
    history_s
        How far back missed data are read from the server's history; 0: never.
    warm_start_s
        How far back the server's history is read at the first start; 0: not at all.
    """

    url: str
    security: Security = Security.NONE
    pki: Pki | None = None
    own: OwnCertificate | None = None
    user: str | None = None
    password: str | None = field(default=None, repr=False)
    on_behalf_of: str = ""
    check_host_name: bool = True
    require_crl: bool = True
    application_uri: str | None = None
    publishing_interval_ms: float = 100.0
    sampling_interval_ms: float = 0.0
    queue_size: int = 1_000
    keep_alive_s: float = 1.0
    timeout_s: float = 5.0
    publish_requests: int = 10
    buffer_limit: int = 1_000_000
    history_s: float = 3_600.0
    warm_start_s: float = 0.0

    def __post_init__(self) -> None:
        """Check the fields and their combination.

        Raises
        ------
        ConfigurationError
            if a field is invalid; names the field.
        """
        parts = urlsplit(self.url)
        if parts.scheme != "opc.tcp" or not parts.hostname or _port(self.url) is None:
            raise ConfigurationError(
                f"url '{self.url}': opc.tcp://<host>:<port>[/<path>] is expected"
            )
        if parts.username is not None:
            raise ConfigurationError(
                f"url of {parts.hostname}: credentials belong to user and password"
            )
        if self.security is not Security.NONE and (self.pki is None or self.own is None):
            raise ConfigurationError(
                f"security {self.security}: pki and own certificate are needed"
            )


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
        server: "TrustedServer | None",
        *,
        resumed: bool,
    ) -> None:
        self.resumed = resumed
        self.settings = settings
        self.session = session
        self.limits: OperationLimits | None = None  # not read yet
        self.types: dict[object, object] = {}  # what is known of data types, as far as read
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

    async def _watch_trust(self, server: "TrustedServer") -> None:
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


@dataclass(frozen=True)
class TrustedServer:
    """The certificate that the server presented, and the trust store to check it against."""

    trust: PeerTrust
    shown: bytes
    application_uri: str

    def check(self) -> x509.Certificate:
        """Check the certificate.

        Raises
        ------
        CertificateRefused
        """
        return self.trust.check(self.shown, Use.SERVER, self.application_uri)

    def check_again(self) -> x509.Certificate:
        """Check the certificate against the trust folders as last read.

        Raises
        ------
        CertificateRefused
        """
        return self.trust.check_again(self.shown, Use.SERVER)


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
                server = await _secure(client, settings)
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


@contextlib.contextmanager
def source_errors(url: str, doing: str) -> Iterator[None]:
    """Convert the exceptions of asyncua to SourceLost or SourceRejected."""
    try:
        yield
    except TimeoutError as error:
        raise SourceLost(f"{url}: no answer while {doing}") from error
    except OSError as error:
        reason = error.strerror or str(error) or type(error).__name__
        advice = "; is the server running, and the url right?" if doing == "connecting" else ""
        raise SourceLost(f"{url}: {reason} while {doing}{advice}") from error
    except ua.UaStatusCodeError as error:
        name = status_name(error.code)
        if error.code in _FINAL:
            raise SourceRejected(f"{url}: {name} while {doing}: {_FINAL[error.code]}") from error
        raise SourceLost(f"{url}: {name} while {doing}") from error
    except Senseless as error:
        raise SourceLost(f"{url}: sent {error} while {doing}") from error
    except ua.UaError as error:
        raise SourceLost(f"{url}: {in_one_line(error)} while {doing}") from error
    except uacrypto.InvalidSignature as error:
        raise SourceLost(f"{url}: a wrong signature while {doing}") from error
    except (ValueError, TypeError, LookupError, AttributeError, struct.error) as error:
        reason = in_one_line(error)
        raise SourceLost(f"{url}: an answer that makes no sense while {doing}: {reason}") from error


def in_one_line(text: object) -> str:
    r"""Return a server's text as one line of bounded length.

    >>> in_one_line("No such\npolicy")
    'No such policy'
    """
    said = str(text)[: _LINE + 1]
    return printable("".join(c if c.isprintable() else " " for c in said), _LINE)


def status_name(code: int) -> str:
    """Name of a StatusCode; its number if it has none.

    >>> status_name(0x80340000)
    'BadNodeIdUnknown'
    """
    name, explanation = ua.status_codes.get_name_and_doc(code & 0xFFFF_0000)
    return f"{name} ({code:#010x})" if explanation.startswith("Unknown StatusCode") else str(name)


def _port(url: str) -> int | None:
    try:
        return urlsplit(url).port
    except ValueError:
        return None


async def _secure(client: Client, settings: SourceSettings) -> TrustedServer | None:
    """Find the server's certificate, check that we trust it, set up keys."""
    if settings.security is Security.NONE:
        if settings.application_uri is not None:
            client.application_uri = settings.application_uri
        return None
    assert settings.pki is not None  # noqa: S101 - settings checked it
    assert settings.own is not None  # noqa: S101 - settings checked it
    client.application_uri = settings.application_uri or _uri_of(settings.own)
    policy = _POLICIES[settings.security]
    endpoints = await client.connect_and_get_server_endpoints()
    offered = sorted({f"{_fragment(e.SecurityPolicyUri)}/{e.SecurityMode.name}" for e in endpoints})
    for endpoint in endpoints:
        if (
            endpoint.SecurityPolicyUri == policy.URI
            and endpoint.SecurityMode == ua.MessageSecurityMode.SignAndEncrypt
            and endpoint.ServerCertificate
        ):
            break
    else:
        raise SourceRejected(
            f"{settings.url}: does not offer {settings.security}/SignAndEncrypt; "
            f"it offers {in_one_line(', '.join(offered))}"
        )
    server = TrustedServer(
        PeerTrust(settings.pki, require_crl=settings.require_crl),
        endpoint.ServerCertificate,
        endpoint.Server.ApplicationUri,
    )
    certificate = _trusted(settings, server, settings.own)
    await client.set_security(
        policy,
        certificate=settings.own.certificate,
        private_key=settings.own.key,
        server_certificate=uacrypto.CertProperties(certificate.public_bytes(_DER), "der"),
        mode=ua.MessageSecurityMode.SignAndEncrypt,
    )
    return server


def _trusted(
    settings: SourceSettings, server: TrustedServer, own: OwnCertificate
) -> x509.Certificate:
    """Return the server's certificate if it passes all checks; otherwise it is in ``rejected``."""
    try:
        certificate = server.check()
        if settings.check_host_name:
            check_host_name(certificate, urlsplit(settings.url).hostname or "")
    except CertificateRefused as refused:
        advice = ""
        if refused.code == ua.StatusCodes.BadCertificateUntrusted:
            mark = thumbprint(first_certificate(server.shown))
            advice = f": compare the thumbprint, then `valvemap trust {mark}`"
        elif refused.code == ua.StatusCodes.BadCertificateHostNameInvalid:
            advice = "; with `valvemap connect`, --trust-server does so"
        raise SourceRejected(f"{settings.url}: {refused}{advice}") from refused
    for known in (certificate, load_certificate(own.certificate)):
        if warning := expiry_warning(known):
            _log.warning("%s: %s", settings.url, warning)
    return certificate


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


def _uri_of(own: OwnCertificate) -> str:
    uris = application_uris(load_certificate(own.certificate))
    if not uris:
        raise CertificateError(f"{own.certificate}: names no application (URI in its SAN)")
    return uris[0]


def _fragment(uri: str | None) -> str:
    return (uri or "").rpartition("#")[2]


_REFUSED_CERTIFICATE = "our certificate is refused; the server must trust it"
_FINAL: dict[int, str] = {
    ua.StatusCodes.BadUserAccessDenied: "user or password are wrong, or lack the right",
    ua.StatusCodes.BadIdentityTokenRejected: "user or password are refused; without a user, "
    "the server takes none that is anonymous",
    ua.StatusCodes.BadIdentityTokenInvalid: "this kind of user is not accepted",
    ua.StatusCodes.BadSecurityChecksFailed: _REFUSED_CERTIFICATE,
    ua.StatusCodes.BadSecurityPolicyRejected: "the server does not offer this security",
    ua.StatusCodes.BadSecurityModeRejected: "the server does not offer this security",
    ua.StatusCodes.BadSecurityModeInsufficient: "the server wants more security",
    ua.StatusCodes.BadApplicationSignatureInvalid: _REFUSED_CERTIFICATE,
    ua.StatusCodes.BadUserSignatureInvalid: "the user's certificate is refused",
    ua.StatusCodes.BadCertificateInvalid: _REFUSED_CERTIFICATE,
    ua.StatusCodes.BadCertificateUntrusted: _REFUSED_CERTIFICATE,
    ua.StatusCodes.BadCertificateTimeInvalid: "our certificate has expired",
    ua.StatusCodes.BadCertificateUriInvalid: "our certificate names another application",
    ua.StatusCodes.BadCertificateUseNotAllowed: _REFUSED_CERTIFICATE,
    ua.StatusCodes.BadCertificateRevoked: "our certificate is revoked",
    ua.StatusCodes.BadCertificateChainIncomplete: _REFUSED_CERTIFICATE,
    ua.StatusCodes.BadTcpEndpointUrlInvalid: "the server does not know this URL",
    ua.StatusCodes.BadServiceUnsupported: "the server does not do this",
    ua.StatusCodes.BadMonitoredItemFilterUnsupported: (
        "the server cannot report every sample (trigger StatusValueTimestamp)"
    ),
}
