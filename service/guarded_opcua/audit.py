"""Audit of user actions: a line in the log and an event for security administrators.

The events are those of Part 5, 6.4, on the Server object. They are created only while a client
monitors them, and their rate is limited, so that password guessing and flooding do not slow down
other clients.
"""

import secrets
from dataclasses import dataclass
from typing import Any, Protocol

from asyncua import ua

from guarded_opcua.allowance import Allowance
from guarded_opcua.binary.encoding import encode_variant, instant
from guarded_opcua.clock import Clock
from guarded_opcua.logs import audit_logger
from guarded_opcua.monitoring.events import Event
from guarded_opcua.security.accounts import Role
from guarded_opcua.security.certificates import thumbprint
from guarded_opcua.security.identity import Principal
from guarded_opcua.subscriptions.registry import Subscriptions

_log = audit_logger()
_Codes = ua.StatusCodes
_Ids = ua.ObjectIds
_Types = ua.VariantType
_SERVER = ua.NodeId(_Ids.Server)
_NORMAL, _REFUSED = 100, 500  # severities
_MAX_FIELD_BYTES = 4_096
_MAX_TEXT = 200
_BURST_S = 5.0

_CERTIFICATE_EVENTS = {
    _Codes.BadCertificateUntrusted: _Ids.AuditCertificateUntrustedEventType,
    _Codes.BadCertificateTimeInvalid: _Ids.AuditCertificateExpiredEventType,
    _Codes.BadCertificateIssuerTimeInvalid: _Ids.AuditCertificateExpiredEventType,
    _Codes.BadCertificateRevoked: _Ids.AuditCertificateRevokedEventType,
    _Codes.BadCertificateIssuerRevoked: _Ids.AuditCertificateRevokedEventType,
    _Codes.BadCertificateUseNotAllowed: _Ids.AuditCertificateMismatchEventType,
    _Codes.BadCertificateIssuerUseNotAllowed: _Ids.AuditCertificateMismatchEventType,
    _Codes.BadCertificateUriInvalid: _Ids.AuditCertificateDataMismatchEventType,
}

Fields = dict[str, ua.Variant]


class Party(Protocol):
    """The session of the acting user."""

    id: ua.NodeId
    application_uri: str
    peer_certificate: bytes | None
    timeout_s: float
    principal: Principal | None


@dataclass(frozen=True)
class Actor:
    """The client that sent a request.

    Attributes
    ----------
    session
        The session, or None before one exists.
    host
        Address of the peer.
    entry
        AuditEntryId: the client's identifier of the request in its own audit log.
    """

    session: Party | None
    host: str
    entry: str = ""

    @property
    def user(self) -> Principal | None:
        """The user of the session, None without one."""
        return self.session.principal if self.session is not None else None


class Audit:
    """Logs user actions and emits audit events for security administrators.

    Parameters
    ----------
    application_uri
        ApplicationUri of the server.
    subscriptions
        The subscriptions of the server, which hold the event items.
    clock
        Clock of the event timestamps.
    per_second
        Maximum event rate, 1/s; suppressed events are counted, and the next event reports the
        count.
    """

    def __init__(
        self, application_uri: str, subscriptions: Subscriptions, clock: Clock, per_second: float
    ) -> None:
        self._application_uri = application_uri
        self._subscriptions = subscriptions
        self._clock = clock
        self._allowance = Allowance(clock, per_second, per_second * _BURST_S)
        self._left_out = 0

    @property
    def is_heard(self) -> bool:
        """Whether a security administrator monitors the events."""
        return self._subscriptions.events.has_audience((_SERVER,), Role.SECURITY_ADMIN)

    def certificate_refused(self, host: str, der: bytes, code: int, sentence: str) -> None:
        """Report that the certificate of a channel was refused."""
        _log.warning("%s", sentence)
        kind = _CERTIFICATE_EVENTS.get(code, _Ids.AuditCertificateInvalidEventType)
        fields = {"Certificate": _bytes(der)}
        self._report(kind, "Security/Certificate", Actor(None, host), code, sentence, fields)

    def channel_opened(
        self, host: str, number: int, asked: ua.OpenSecureChannelParameters, policy: str, der: bytes
    ) -> None:
        """Report that a peer, with its certificate, opened or renewed a secure channel."""
        said = f"secure channel opened by {host}"
        name = thumbprint(der).upper() if der else ""
        fields = {
            "SecureChannelId": ua.Variant(str(number), _Types.String),
            "ClientCertificate": _bytes(der),
            "ClientCertificateThumbprint": ua.Variant(name, _Types.String),
            "RequestType": ua.Variant(int(asked.RequestType), _Types.Int32),
            "SecurityPolicyUri": ua.Variant(policy, _Types.String),
            "SecurityMode": ua.Variant(int(asked.SecurityMode), _Types.Int32),
            "RequestedLifetime": ua.Variant(float(asked.RequestedLifetime), _Types.Double),
        }
        kind = _Ids.AuditOpenSecureChannelEventType
        actor = Actor(None, host)
        self._report(kind, "SecureChannel/OpenSecureChannel", actor, _Codes.Good, said, fields)

    def cancelled(self, actor: Actor, handle: int) -> None:
        """Report that a client cancelled its requests."""
        said = f"cancel by {actor.user} at {actor.host}"
        fields = {"RequestHandle": ua.Variant(handle, _Types.UInt32)}
        kind = _Ids.AuditCancelEventType
        self._report(kind, "Session/Cancel", actor, _Codes.Good, said, fields)

    def session_refused(self, actor: Actor, code: int, token: object = None) -> None:
        """Report that CreateSession or ActivateSession was refused."""
        reason = ua.StatusCode(code).name
        _log.warning("session refused at %s: %s", actor.host, reason)
        said = f"session refused at {actor.host}: {reason}"
        if code == _Codes.BadCertificateUriInvalid:
            kind = _Ids.AuditCertificateDataMismatchEventType
            self._report(kind, "Security/Certificate", actor, code, said, {})
        if actor.session is None:
            kind, source = _Ids.AuditCreateSessionEventType, "Session/CreateSession"
        else:
            kind, source = _Ids.AuditActivateSessionEventType, "Session/ActivateSession"
        self._report(kind, source, actor, code, said, _token(token))

    def session_created(self, actor: Actor, channel: int) -> None:
        """Report that a session was created."""
        session = actor.session
        if session is None:
            return
        application = shown(session.application_uri)
        _log.info("session created by %s at %s", application, actor.host)
        certificate = session.peer_certificate or b""
        name = thumbprint(certificate).upper() if certificate else ""
        fields = {
            "SecureChannelId": ua.Variant(str(channel), _Types.String),
            "ClientCertificate": _bytes(certificate),
            "ClientCertificateThumbprint": ua.Variant(name, _Types.String),
            "RevisedSessionTimeout": ua.Variant(session.timeout_s * 1e3, _Types.Double),
        }
        said = f"session created by {application} at {actor.host}"
        kind = _Ids.AuditCreateSessionEventType
        self._report(kind, "Session/CreateSession", actor, _Codes.Good, said, fields)

    def session_activated(self, actor: Actor, channel: int, token: object) -> None:
        """Report that a user logged in."""
        _log.info("session activated by %s at %s", actor.user, actor.host)
        fields = {"SecureChannelId": ua.Variant(str(channel), _Types.String), **_token(token)}
        said = f"session activated by {actor.user} at {actor.host}"
        kind = _Ids.AuditActivateSessionEventType
        self._report(kind, "Session/ActivateSession", actor, _Codes.Good, said, fields)

    def session_closed(self, actor: Actor, *, timed_out: bool = False) -> None:
        """Report that a session ended."""
        end = "timed out" if timed_out else "closed"
        _log.info("session %s of %s at %s", end, actor.user, actor.host)
        source = "Session/Timeout" if timed_out else "Session/CloseSession"
        said = f"session {end} of {actor.user} at {actor.host}"
        self._report(_Ids.AuditSessionEventType, source, actor, _Codes.Good, said, {})

    def written(self, actor: Actor, item: ua.WriteValue, before: ua.DataValue, code: int) -> None:
        """Report a write, accepted or refused."""
        said = self._said("write", item.NodeId, actor, code)
        if not self.is_heard:
            return
        fields = {
            "AttributeId": ua.Variant(int(item.AttributeId), _Types.UInt32),
            "IndexRange": ua.Variant((item.IndexRange or "")[:_MAX_TEXT], _Types.String),
            "NewValue": item.Value.Value or ua.Variant(),
            "OldValue": before.Value or ua.Variant(),
        }
        kind, source = _Ids.AuditWriteUpdateEventType, "Attribute/Write"
        self._report(kind, source, actor, code, said, fields, item.NodeId)

    def called(self, actor: Actor, request: ua.CallMethodRequest, code: int) -> None:
        """Report a method call, executed or refused."""
        said = self._said("call", request.MethodId, actor, code)
        if not self.is_heard:
            return
        given = request.InputArguments or []
        fields = {
            "MethodId": ua.Variant(request.MethodId, _Types.NodeId),
            "InputArguments": ua.Variant(list(given), _Types.Variant, is_array=True),
        }
        kind, source = _Ids.AuditUpdateMethodEventType, "Attribute/Call"
        self._report(kind, source, actor, code, said, fields, request.ObjectId)

    def _said(self, what: str, node: ua.NodeId, actor: Actor, code: int) -> str:
        who = actor.user
        target, status = ascii(node.to_string())[1:-1][:120], ua.StatusCode(code).name
        _log.info("%s %s by %s at %s: %s", what, target, who, actor.host, status)
        return f"{what} {target} by {who} at {actor.host}: {status}"

    def _report(
        self,
        kind: int,
        source: str,
        actor: Actor,
        code: int,
        said: str,
        more: Fields,
        node: ua.NodeId = _SERVER,
    ) -> None:
        if not self.is_heard:
            return
        if not self._allowance.covers(1.0):
            self._left_out += 1
            self._subscriptions.ledger.lost += 1
            return
        if self._left_out:
            said, self._left_out = f"{said} ({self._left_out} events before it left out)", 0
        now = instant(self._clock.now())
        user = actor.user.name if actor.user is not None else ""
        good = code == _Codes.Good
        fields = {
            "EventId": _bytes(secrets.token_bytes(16)),
            "EventType": ua.Variant(ua.NodeId(kind), _Types.NodeId),
            "SourceNode": _bounded(ua.Variant(node, _Types.NodeId)),
            "SourceName": ua.Variant(source, _Types.String),
            "Time": ua.Variant(now, _Types.DateTime),
            "ReceiveTime": ua.Variant(now, _Types.DateTime),
            "Message": ua.Variant(ua.LocalizedText(said, "en"), _Types.LocalizedText),
            "Severity": ua.Variant(_NORMAL if good else _REFUSED, _Types.UInt16),
            "ActionTimeStamp": ua.Variant(now, _Types.DateTime),
            "Status": ua.Variant(good, _Types.Boolean),
            "ServerId": ua.Variant(self._application_uri, _Types.String),
            "ClientAuditEntryId": ua.Variant(actor.entry[:_MAX_TEXT], _Types.String),
            "ClientUserId": ua.Variant(user[:_MAX_TEXT], _Types.String),
            "StatusCodeId": ua.Variant(ua.StatusCode(code), _Types.StatusCode),
            **{name: _bounded(value) for name, value in more.items()},
        }
        if actor.session is not None:
            fields["SessionId"] = ua.Variant(actor.session.id, _Types.NodeId)
        event = Event((_SERVER,), ua.NodeId(kind), fields, Role.SECURITY_ADMIN)
        self._subscriptions.events.trigger(event)


def shown(text: str | None) -> str:
    """Return a peer's own text, escaped and truncated, so that it is safe to log."""
    return ascii((text or "")[:120])[1:-1]


def _token(token: object) -> Fields:
    """Return the user name of an identity token, never its password."""
    if isinstance(token, ua.UserNameIdentityToken):
        name = (token.UserName or "")[:_MAX_TEXT]
        safe: Any = ua.UserNameIdentityToken("username", name, None, None)
    elif isinstance(token, ua.X509IdentityToken):
        certificate = token.CertificateData or b""
        safe = ua.X509IdentityToken("certificate", certificate)
    elif isinstance(token, ua.AnonymousIdentityToken):
        safe = ua.AnonymousIdentityToken("anonymous")
    else:
        return {}
    return {"UserIdentityToken": ua.Variant(safe, _Types.ExtensionObject)}


def _bounded(value: ua.Variant) -> ua.Variant:
    """Return a value, or a null Variant if it is too large to queue."""
    try:
        return value if len(encode_variant(value)) <= _MAX_FIELD_BYTES else ua.Variant()
    except Exception:  # noqa: BLE001 - what a peer sent may not even be encoded again
        return ua.Variant()


def _bytes(content: bytes) -> ua.Variant:
    return ua.Variant(content, _Types.ByteString)
