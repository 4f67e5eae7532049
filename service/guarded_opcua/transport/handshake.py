"""Services without an active session: channel, discovery, sessions (Part 4, 5.5-5.7)."""

import contextlib
import ipaddress
import re
from collections.abc import Awaitable, Iterator
from functools import partial
from typing import Any, Protocol, TypeVar
from urllib.parse import urlparse

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto import uacrypto
from cryptography.exceptions import InvalidSignature

from guarded_opcua.audit import Actor
from guarded_opcua.binary.bounded_decoding import Budget, Reader, decode
from guarded_opcua.security.certificate_rules import first_certificate
from guarded_opcua.security.identity import Challenge, identify
from guarded_opcua.security.peer_certificates import application_uris
from guarded_opcua.sessions.session import Line, Session
from guarded_opcua.transport.channel import Channel
from guarded_opcua.transport.shared import Shared

_Codes = ua.StatusCodes
_Ids = ua.ObjectIds

_CREATE = _Ids.CreateSessionRequest_Encoding_DefaultBinary
_ACTIVATE = _Ids.ActivateSessionRequest_Encoding_DefaultBinary
_CLOSE = _Ids.CloseSessionRequest_Encoding_DefaultBinary
_ENDPOINTS = _Ids.GetEndpointsRequest_Encoding_DefaultBinary
_SERVERS = _Ids.FindServersRequest_Encoding_DefaultBinary
_DISCOVERY = (_ENDPOINTS, _SERVERS)
_SMALLEST_NONCE = 32
_HOST = re.compile(r"[A-Za-z0-9._\-\[\]:]{1,255}")


T = TypeVar("T")


class PeerSide(Line, Protocol):
    """The connection, as the handshake uses it."""

    @property
    def channel(self) -> Channel:
        """The secure channel."""

    async def outside(self, slow: Awaitable[T]) -> T:
        """Await a slow operation with the turn released."""

    def send_open(self, request_id: int, response: ua.OpenSecureChannelResponse) -> None:
        """Answer an OpenSecureChannel."""

    def log_in(self) -> None:
        """Apply the limits of authenticated users."""


class Handshake:
    """Opens the secure channel and activates sessions of one connection."""

    def __init__(self, shared: Shared, peer: PeerSide) -> None:
        self.done = False
        self._shared = shared
        self._peer = peer

    def open_channel(self, message: ua.Message, budget: Budget) -> None:
        """Open or renew the secure channel."""
        channel = self._peer.channel
        algorithm = message.SecurityHeader()
        request = decode(ua.OpenSecureChannelRequest, Reader(bytes(message.body()), budget))
        if not channel.is_open():
            channel.select_policy(
                algorithm.SecurityPolicyURI,
                algorithm.SenderCertificate,
                request.Parameters.SecurityMode,
            )
        response = ua.OpenSecureChannelResponse()
        response.Parameters = channel.open(request.Parameters, self._shared.channel_numbers)
        response.ResponseHeader.RequestHandle = request.RequestHeader.RequestHandle
        self._shared.audit.channel_opened(
            self._peer.host,
            channel.security_token.ChannelId,
            request.Parameters,
            channel.security_policy.URI,
            channel.peer_certificate or b"",
        )
        self._peer.send_open(message.SequenceHeader().RequestId, response)

    def answers(self, service: object) -> bool:
        """Whether a service needs no active session."""
        return service in (_CREATE, _ACTIVATE, _CLOSE, *_DISCOVERY)

    def session_of(self, header: ua.RequestHeader) -> Session:
        """Find the active session of a request.

        Raises
        ------
        ServiceError
            BadSessionIdInvalid, BadSessionNotActivated, BadSecureChannelIdInvalid.
        """
        self._check_policy()
        session = self._shared.sessions.find(header.AuthenticationToken)
        if session.line is not self._peer:
            raise ServiceError(_Codes.BadSecureChannelIdInvalid)
        if not session.active:
            raise ServiceError(_Codes.BadSessionNotActivated)
        return session

    async def answer(self, service: object, header: ua.RequestHeader, body: Reader) -> Any:  # noqa: ANN401 - any response
        """Answer a request that needs no active session.

        Raises
        ------
        ServiceError
        """
        if service not in _DISCOVERY:
            self._check_policy()
        if service == _ENDPOINTS:
            asked = decode(ua.GetEndpointsParameters, body)
            return ua.GetEndpointsResponse(Endpoints=self._endpoints(asked))
        if service == _SERVERS:
            wanted = decode(ua.FindServersParameters, body)
            return ua.FindServersResponse(Servers=self._servers(wanted))
        if service == _CREATE:
            create = decode(ua.CreateSessionParameters, body)
            with self._reporting_refusals(Actor(None, self._peer.host, _entry(header))):
                return self._create(header, create)
        if service == _ACTIVATE:
            activate = decode(ua.ActivateSessionParameters, body)
            session = self._shared.sessions.get(header.AuthenticationToken)
            actor = Actor(session, self._peer.host, _entry(header))
            with self._reporting_refusals(actor, activate.UserIdentityToken):
                return await self._activate(actor, header, activate)
        keep = not decode(ua.Boolean, body)
        return self._close(header, keep_subscriptions=keep)

    @contextlib.contextmanager
    def _reporting_refusals(self, actor: Actor, token: object = None) -> Iterator[None]:
        try:
            yield
        except ServiceError as error:
            self._shared.audit.session_refused(actor, error.code, token)
            if error.code != _Codes.BadTooManySessions:
                self._shared.sessions.totals.refused_for_security += 1
            raise

    def _check_policy(self) -> None:
        if self._peer.channel.discovery_only:
            raise ServiceError(_Codes.BadSecurityPolicyRejected)

    def _create(
        self, header: ua.RequestHeader, params: ua.CreateSessionParameters
    ) -> ua.CreateSessionResponse:
        channel, shared = self._peer.channel, self._shared
        policy = channel.security_policy
        certificate = channel.peer_certificate
        if certificate is not None:
            if first_certificate(params.ClientCertificate or b"") != certificate:
                raise ServiceError(_Codes.BadSecurityChecksFailed)
            if len(params.ClientNonce or b"") < _SMALLEST_NONCE:
                raise ServiceError(_Codes.BadNonceInvalid)
            shown = uacrypto.x509_from_der(certificate)
            if params.ClientDescription.ApplicationUri not in application_uris(shown):
                raise ServiceError(_Codes.BadCertificateUriInvalid)
        session = shared.sessions.create(self._peer, params)
        asked = ua.GetEndpointsParameters(EndpointUrl=params.EndpointUrl)
        response = ua.CreateSessionResponse()
        result = response.Parameters
        result.SessionId = session.id
        result.AuthenticationToken = session.token
        result.RevisedSessionTimeout = session.timeout_s * 1e3
        result.ServerNonce = session.nonce
        result.ServerCertificate = shared.own.certificate
        result.ServerEndpoints = self._endpoints(asked)
        result.MaxRequestMessageSize = shared.limits.message_bytes
        if certificate is not None:
            proof = certificate + (params.ClientNonce or b"")
            result.ServerSignature.Signature = policy.asymmetric_cryptography.signature(proof)
            result.ServerSignature.Algorithm = policy.AsymmetricSignatureURI
        actor = Actor(session, session.host, _entry(header))
        shared.audit.session_created(actor, channel.security_token.ChannelId)
        return response

    async def _activate(
        self, actor: Actor, header: ua.RequestHeader, params: ua.ActivateSessionParameters
    ) -> ua.ActivateSessionResponse:
        shared, peer = self._shared, self._peer
        session = shared.sessions.find(header.AuthenticationToken)
        moves = session.line is not peer
        if peer.peer_certificate != session.peer_certificate:
            raise ServiceError(_Codes.BadSecurityChecksFailed)
        self._verify(session, params.ClientSignature)
        challenge = Challenge(shared.own.certificate, shared.own.key, session.nonce)
        principal = await peer.outside(
            identify(
                params.UserIdentityToken,
                params.UserTokenSignature,
                challenge,
                shared.users,
                self._origin(session, _entry(header)),
                shared.logins,
                shared.trust,
                partial(shared.audit.certificate_refused, session.host),
                anonymous_allowed=shared.anonymous_allowed,
            )
        )
        if moves and (not session.active or principal != session.principal):
            raise ServiceError(_Codes.BadIdentityTokenRejected)
        if session.closed:
            raise ServiceError(_Codes.BadSessionIdInvalid)
        if principal != session.principal:
            shared.sessions.admit(session, principal)
        session.principal = principal
        if moves:
            session.bind(peer)
        session.touch()
        self.done = True
        peer.log_in()
        channel = peer.channel.security_token.ChannelId
        shared.audit.session_activated(actor, channel, params.UserIdentityToken)
        response = ua.ActivateSessionResponse()
        response.Parameters.ServerNonce = session.new_nonce()
        return response

    def _close(
        self, header: ua.RequestHeader, *, keep_subscriptions: bool
    ) -> ua.CloseSessionResponse:
        session = self._shared.sessions.find(header.AuthenticationToken)
        if session.line is not self._peer:
            raise ServiceError(_Codes.BadSecureChannelIdInvalid)
        keep = keep_subscriptions and session.is_proven  # an anonymous peer has no claim
        self._shared.sessions.close(session, keep_subscriptions=keep)
        self._shared.audit.session_closed(Actor(session, session.host, _entry(header)))
        return ua.CloseSessionResponse()

    def _origin(self, session: Session, entry: str) -> str:
        """Return the address of a user; behind a gateway, the one that the gateway reports."""
        if session.application_uri not in self._shared.gateways:
            return session.host
        try:
            behind = ipaddress.ip_network(entry, strict=False)
        except ValueError:
            return session.host
        return f"{behind} by way of {session.host}"

    def _verify(self, session: Session, signature: ua.SignatureData) -> None:
        """Check that the client holds the private key of the channel's certificate."""
        channel = self._peer.channel
        if channel.is_plain:
            return
        proof = self._shared.own.certificate + session.nonce
        try:
            channel.security_policy.asymmetric_cryptography.verify(
                proof, signature.Signature or b""
            )
        except (InvalidSignature, uacrypto.InvalidSignature) as error:
            raise ServiceError(_Codes.BadApplicationSignatureInvalid) from error

    def _endpoints(self, params: ua.GetEndpointsParameters) -> list[ua.EndpointDescription]:
        profiles = params.ProfileUris or []
        return [
            endpoint
            for endpoint in self._shared.endpoints(self._reached_as(params.EndpointUrl))
            if not profiles or endpoint.TransportProfileUri in profiles
        ]

    def _servers(self, params: ua.FindServersParameters) -> list[ua.ApplicationDescription]:
        endpoints = self._shared.endpoints(self._reached_as(params.EndpointUrl))
        server = endpoints[0].Server
        wanted = params.ServerUris or []
        return [server] if not wanted or server.ApplicationUri in wanted else []

    def _reached_as(self, url: str | None) -> str | None:
        """Return the host and port of an endpoint URL from the peer, None if it is malformed."""
        try:
            found = urlparse(url or "").netloc
        except ValueError:
            return None
        return found if _HOST.fullmatch(found) else None


def _entry(header: ua.RequestHeader) -> str:
    return header.AuditEntryId or ""
