"""The hardened server: identity, endpoints, values; it knows nothing of what it serves."""

import dataclasses
import datetime as dt
import ipaddress
import logging
from collections.abc import Coroutine, Iterable
from types import TracebackType
from typing import Any, Self
from urllib.parse import urlparse

from asyncua import Server, ua
from asyncua.common.connection import TransportLimits
from asyncua.crypto import security_policies, uacrypto
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import rsa

from service.clock import Clock, SystemClock
from service.errors import ConfigurationError, ServerError
from service.opcua.hardened.certificates import (
    KEY_BITS,
    ensure_certificate,
    expiry_warning,
    load_certificate,
    make_certificate,
)
from service.opcua.hardened.connection import GuardedBinaryServer
from service.opcua.hardened.internal import GuardedInternalServer
from service.opcua.hardened.nodes import Method, Value, Variable, as_variant
from service.opcua.hardened.session import GuardedSession
from service.opcua.hardened.settings import ServerSettings

_log = logging.getLogger(__name__)
_SECURED = (
    (security_policies.SecurityPolicyBasic256Sha256, 70),
    (security_policies.SecurityPolicyAes256Sha256RsaPss, 80),
)
_MODE = ua.MessageSecurityMode.SignAndEncrypt
_TRANSPORT = "http://opcfoundation.org/UA-Profile/Transport/uatcp-uasc-uabinary"
_EPOCH = dt.datetime(1970, 1, 1, tzinfo=dt.UTC)

Update = tuple[Variable, Value, int, int]


class HardenedServer:
    """An OPC UA server with our guard, PKI and users.

    Make it with :meth:`create`, add nodes, then ``async with`` it or call :meth:`start` and
    :meth:`stop`.
    """

    def __init__(self, settings: ServerSettings, clock: Clock | None = None) -> None:
        self.settings = settings
        self._clock = clock or SystemClock()
        self._inside = GuardedInternalServer(settings, self._take_write)
        self.ua = Server(iserver=self._inside)
        self._listener: GuardedBinaryServer | None = None
        self._certificate: x509.Certificate | None = None
        self.namespace_index = 0

    @classmethod
    async def create(cls, settings: ServerSettings, clock: Clock | None = None) -> Self:
        """Make a server with its standard nodes; it does not listen yet.

        Raises
        ------
        ConfigurationError
            if the settings contradict each other.
        CertificateError
            if certificate or key cannot be had.
        """
        _check(settings)
        server = cls(settings, clock)
        server.ua.name = settings.application_name
        server.ua.product_uri = settings.product_uri
        server.ua.manufacturer_name = "valvemap"
        await server.ua.init()
        await server.ua.set_application_uri(settings.application_uri)
        server.namespace_index = await server.namespace(settings.namespace_uri)
        return server

    @property
    def session(self) -> GuardedSession:
        """The server's own session, which may do everything."""
        return self._inside.isession

    @property
    def url(self) -> str:
        """Where the server listens; with port 0 known once it is started."""
        parsed = urlparse(self.settings.url)
        port = self._listener.port if self._listener else parsed.port
        return parsed._replace(netloc=f"{_bracketed(parsed.hostname or '')}:{port}").geturl()

    async def namespace(self, uri: str) -> int:
        """Return the index of a namespace, registering it if it is new."""
        return await self.ua.register_namespace(uri)

    def register_variable(self, variable: Variable, value: Value) -> None:
        """Take a variable into care (called by ``add_variable``)."""
        self._inside.variables[variable.id] = variable
        waiting = ua.StatusCodes.BadWaitingForInitialData
        code = waiting if value is None else ua.StatusCodes.Good
        self.write([(variable, value, code, self._clock.now())])

    def register_method(self, method: Method) -> None:
        """Take a method into care (called by ``add_method``)."""
        self._inside.methods[method.id] = method

    def write(self, updates: Iterable[Update]) -> None:
        """Publish values: in order, all within one turn of the event loop.

        Parameters
        ----------
        updates
            Tuples (variable, value, status code, source time in UTC ns). With a Bad status the
            value is dropped, as OPC UA Part 4, 7.7.1 demands; Uncertain keeps it.
        """
        server_time = _time(self._clock.now())
        for variable, value, code, source_time in updates:
            data = _data_value(variable, value, code, _time(source_time), server_time)
            _drive(
                self._inside.aspace.write_attribute_value(variable.id, ua.AttributeIds.Value, data)
            )

    def mark(self, variable: Variable, code: int) -> None:
        """Change the status of a variable's value, keeping value and source time."""
        held = self._inside.aspace.read_attribute_value(variable.id, ua.AttributeIds.Value)
        data = dataclasses.replace(
            held, StatusCode=ua.StatusCode(code), ServerTimestamp=_time(self._clock.now())
        )
        _drive(self._inside.aspace.write_attribute_value(variable.id, ua.AttributeIds.Value, data))

    @property
    def lost_notifications(self) -> int:
        """Notifications that were discarded because a client's queue was full."""
        return 0

    async def start(self) -> None:
        """Listen.

        Raises
        ------
        ServerError
            if the address is in use or not ours: names the endpoint.
        CertificateError
            if certificate or key cannot be had.
        """
        parsed = urlparse(self.settings.url)
        limits = self.settings.limits
        self._listener = GuardedBinaryServer(
            self._inside,
            (parsed.hostname or "").strip("[]"),
            parsed.port or 0,
            TransportLimits(
                max_recv_buffer=limits.chunk_bytes,
                max_send_buffer=limits.chunk_bytes,
                max_chunk_count=limits.chunks,
                max_message_size=limits.message_bytes,
            ),
        )
        self._load_certificate()
        self._listener.set_policies(self._policies())
        try:
            await self._listener.start()
        except OSError as error:
            self._listener = None
            raise ServerError(
                f"{self.settings.url}: cannot listen there: {error.strerror or error}"
            ) from error
        self._announce_endpoints()
        await self._inside.start()
        if self.settings.none_on_loopback:
            _log.warning("%s: also open without security, on loopback (demo only)", self.url)

    async def stop(self) -> None:
        """Stop listening and close every session; safe to call twice."""
        listener, self._listener = self._listener, None
        if listener is not None:
            await listener.stop()
            await self._inside.stop()

    async def __aenter__(self) -> Self:
        await self.start()
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self.stop()

    def _take_write(self, variable: Variable, value: Value, at: dt.datetime | None) -> None:
        now = self._clock.now()
        source = now if at is None else (at - _EPOCH) // dt.timedelta(microseconds=1) * 1000
        self.write([(variable, value, ua.StatusCodes.Good, source)])

    def _load_certificate(self) -> None:
        settings = self.settings
        names = settings.host_names or ("localhost", "127.0.0.1")
        if settings.pki is None:
            key = rsa.generate_private_key(public_exponent=65537, key_size=KEY_BITS)
            certificate = make_certificate(
                key, settings.application_uri, names, settings.application_name
            )
        else:
            file_name = "".join(c if c.isalnum() else "-" for c in settings.application_name)
            own = ensure_certificate(settings.pki, settings.application_uri, names, file_name)
            certificate = load_certificate(own.certificate)
            loaded = serialization.load_pem_private_key(own.key.read_bytes(), None)
            assert isinstance(loaded, rsa.RSAPrivateKey)  # noqa: S101 - ensure_certificate checked
            key = loaded
        if warning := expiry_warning(certificate):
            _log.warning("%s", warning)
        self._inside.certificate, self._inside.private_key = certificate, key

    def _policies(self) -> list[security_policies.SecurityPolicyFactory]:
        key, certificate = self._inside.private_key, self._inside.certificate
        factories = []
        if self.settings.pki is not None:
            factories += [
                security_policies.SecurityPolicyFactory(policy, _MODE, certificate, key)
                for policy, _ in _SECURED
            ]
        if self.settings.none_on_loopback:
            factories.append(
                security_policies.SecurityPolicyFactory(
                    security_policies.SecurityPolicyNone,
                    ua.MessageSecurityMode.None_,
                    certificate,
                    key,
                )
            )
        return factories

    def _announce_endpoints(self) -> None:
        self._inside.endpoints.clear()
        if self.settings.pki is not None:
            for policy, level in _SECURED:
                self._announce(policy.URI, _MODE, level)
        if self.settings.none_on_loopback:
            uri = security_policies.SecurityPolicyNone.URI
            self._announce(uri, ua.MessageSecurityMode.None_, 0)

    def _announce(self, policy: str, mode: ua.MessageSecurityMode, level: int) -> None:
        settings = self.settings
        description = ua.ApplicationDescription(
            ApplicationUri=settings.application_uri,
            ProductUri=settings.product_uri,
            ApplicationName=ua.LocalizedText(settings.application_name),
            ApplicationType=ua.ApplicationType.Server,
            DiscoveryUrls=[self.url],
        )
        password_policy = security_policies.SecurityPolicyBasic256Sha256.URI
        tokens = [
            ua.UserTokenPolicy(
                PolicyId="username",
                TokenType=ua.UserTokenType.UserName,
                SecurityPolicyUri=password_policy,
            )
        ]
        if settings.none_on_loopback or settings.anonymous_observer:
            tokens.insert(
                0, ua.UserTokenPolicy(PolicyId="anonymous", TokenType=ua.UserTokenType.Anonymous)
            )
        self._inside.add_endpoint(
            ua.EndpointDescription(
                EndpointUrl=self.url,
                Server=description,
                ServerCertificate=uacrypto.der_from_x509(self._inside.certificate),
                SecurityMode=mode,
                SecurityPolicyUri=policy,
                UserIdentityTokens=tokens,
                TransportProfileUri=_TRANSPORT,
                SecurityLevel=level,
            )
        )


def _check(settings: ServerSettings) -> None:
    parsed = urlparse(settings.url)
    if parsed.scheme != "opc.tcp" or not parsed.hostname or parsed.port is None:
        raise ConfigurationError(
            f"{settings.url}: an endpoint like opc.tcp://127.0.0.1:4840/path/ is needed"
        )
    if settings.none_on_loopback and parsed.hostname not in ("127.0.0.1", "::1"):
        raise ConfigurationError(
            f"{settings.url}: without security a server listens on 127.0.0.1 or ::1 only"
        )
    if settings.pki is None and not settings.none_on_loopback:
        raise ConfigurationError(f"{settings.url}: a server on the network needs a PKI folder")


def _data_value(
    variable: Variable,
    value: Value,
    code: int,
    source_time: dt.datetime,
    server_time: dt.datetime,
) -> ua.DataValue:
    bad = code & 0x8000_0000
    return ua.DataValue(
        ua.Variant() if bad else as_variant(variable.type, value, array=variable.array),
        ua.StatusCode(code),
        source_time,
        server_time,
    )


def _drive(coroutine: Coroutine[Any, Any, Any]) -> None:
    """Run a coroutine that never waits: the callbacks behind a write only queue."""
    try:
        coroutine.send(None)
    except StopIteration:
        return
    coroutine.close()
    raise RuntimeError("a data change callback waits")


def _time(nanoseconds: int) -> dt.datetime:
    return _EPOCH + dt.timedelta(microseconds=nanoseconds // 1000)


def _bracketed(host: str) -> str:
    try:
        return f"[{host}]" if ipaddress.ip_address(host).version == 6 else host
    except ValueError:
        return host
