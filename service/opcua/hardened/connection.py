"""What a connection may send before it is believed: frames, channels, services."""

import logging
import time
from typing import TYPE_CHECKING

from asyncua import ua
from asyncua.common.connection import SecureConnection, TransportLimits
from asyncua.common.utils import Buffer, ServiceError
from asyncua.crypto.security_policies import SecurityPolicyNone
from asyncua.server.binary_server_asyncio import BinaryServer, OPCUAProtocol
from asyncua.server.uaprocessor import UaProcessor
from asyncua.ua import ua_binary
from typing_extensions import override

if TYPE_CHECKING:
    import asyncio

    from service.opcua.hardened.internal import GuardedInternalServer

_log = logging.getLogger(__name__)
_Codes = ua.StatusCodes
_Ids = ua.ObjectIds

_DISCOVERY = {
    _Ids.GetEndpointsRequest_Encoding_DefaultBinary,
    _Ids.FindServersRequest_Encoding_DefaultBinary,
    _Ids.CloseSecureChannelRequest_Encoding_DefaultBinary,
}
_CREATE = _Ids.CreateSessionRequest_Encoding_DefaultBinary
_ACTIVATE = _Ids.ActivateSessionRequest_Encoding_DefaultBinary
_CLOSE = _Ids.CloseSessionRequest_Encoding_DefaultBinary
_WITHOUT_SESSION = _DISCOVERY | {_CREATE, _ACTIVATE, _CLOSE}
# offset of the array of operations in the request's body
_OPERATIONS = {
    _Ids.ReadRequest_Encoding_DefaultBinary: 12,
    _Ids.WriteRequest_Encoding_DefaultBinary: 0,
    _Ids.CallRequest_Encoding_DefaultBinary: 0,
    _Ids.TranslateBrowsePathsToNodeIdsRequest_Encoding_DefaultBinary: 0,
    _Ids.CreateMonitoredItemsRequest_Encoding_DefaultBinary: 8,
    _Ids.DeleteSubscriptionsRequest_Encoding_DefaultBinary: 0,
}
_FRAMES = (b"HEL", b"OPN", b"MSG", b"CLO")


class GuardedChannel(SecureConnection):
    """A secure channel that opens only with a policy on offer, or for discovery alone."""

    discovery_only = False

    def select_policy(
        self, uri: str, peer_certificate: bytes | None, mode: ua.MessageSecurityMode | None = None
    ) -> None:
        """Select a policy on offer; without security only discovery is answered otherwise."""
        if any(policy.matches(uri, mode) for policy in self._policies):
            super().select_policy(uri, peer_certificate, mode)
            return
        if uri.endswith("#None") and mode in (None, ua.MessageSecurityMode.None_):
            self.discovery_only = True
            return
        raise ua.UaError(f"security policy not offered: {uri}")


class GuardedProcessor(UaProcessor):
    """Checks each request before asyncua acts on it."""

    iserver: "GuardedInternalServer"

    def __init__(
        self,
        internal_server: "GuardedInternalServer",
        transport: "asyncio.Transport",
        limits: TransportLimits,
    ) -> None:
        super().__init__(internal_server, transport, limits)
        self._connection = GuardedChannel(SecurityPolicyNone(), self._limits)

    @override
    async def _process_message(
        self,
        typeid: ua.NodeId,
        requesthdr: ua.RequestHeader,
        seqhdr: ua.SequenceHeader,
        body: Buffer,
    ) -> bool | None:
        service = typeid.Identifier
        active = self.session is not None and self.session.is_activated()
        if not active and service not in _WITHOUT_SESSION:
            raise ServiceError(_Codes.BadSessionNotActivated)
        if self._connection.discovery_only and service not in _DISCOVERY:
            raise ServiceError(_Codes.BadSecurityPolicyRejected)
        if self.session is None:
            if service in (_ACTIVATE, _CLOSE):
                raise ServiceError(_Codes.BadSessionIdInvalid)
        elif (
            service not in _DISCOVERY
            and service != _CREATE
            and requesthdr.AuthenticationToken != self.session.auth_token
        ):
            raise ServiceError(_Codes.BadSessionIdInvalid)
        if service in _OPERATIONS:
            self._check_operations(body, _OPERATIONS[service])
        if service == _CREATE:
            self._check_create(body)
        return await super()._process_message(typeid, requesthdr, seqhdr, body)

    def _check_operations(self, body: Buffer, offset: int) -> None:
        peek = body.copy(offset + 4)
        peek.skip(offset)
        count = int.from_bytes(peek.read(4), "little", signed=True)
        if count > self.iserver.limits.operations:
            raise ServiceError(_Codes.BadTooManyOperations)

    def _check_create(self, body: Buffer) -> None:
        if self.session is not None:
            raise ServiceError(_Codes.BadTooManySessions)
        channel = self._connection.security_policy.peer_certificate
        if channel:
            shown = ua_binary.struct_from_binary(ua.CreateSessionParameters, body.copy())
            if shown.ClientCertificate != channel:
                raise ServiceError(_Codes.BadSecurityChecksFailed)


class GuardedProtocol(OPCUAProtocol):
    """Cuts frames itself, so that nothing is kept or parsed beyond the limits."""

    iserver: "GuardedInternalServer"
    processor: GuardedProcessor | None

    def connection_made(self, transport: "asyncio.BaseTransport") -> None:
        """Refuse too many connections of one host, then start."""
        limits = self.iserver.limits
        host = _host(transport.get_extra_info("peername"))
        if sum(_host(peer.peer_name) == host for peer in self.clients) >= (
            limits.connections_per_host
        ):
            _log.warning("%s: refused, too many connections", host)
            transport.abort()  # type: ignore[attr-defined]
            return
        super().connection_made(transport)
        if self.processor is not None:
            self.processor = GuardedProcessor(self.iserver, self.transport, self.limits)
            self.processor.set_policies(self.policies)
        self._frames = bytearray()
        self._before_session = 0
        self._allowance = limits.request_burst
        self._last = time.monotonic()

    @override
    def data_received(self, data: bytes) -> None:  # noqa: PLR0911 - each limit ends the connection
        """Cut whole frames; close on what is too much or no frame."""
        if self.transport is None or self.transport.is_closing():
            return
        limits = self.iserver.limits
        if self.transport.get_write_buffer_size() > limits.unsent_bytes:
            self._abort("reads too slowly")
            return
        session = self.processor.session if self.processor else None
        if session is None or not session.is_activated():
            self._before_session += len(data)
            if self._before_session > limits.handshake_bytes:
                self._abort("sends too much before its session is activated")
                return
        self._frames += data
        while len(self._frames) >= 8:
            size = int.from_bytes(self._frames[4:8], "little")
            if bytes(self._frames[:3]) not in _FRAMES or not 8 <= size <= limits.chunk_bytes:
                self._abort("sends no OPC UA frame, or one too large")
                return
            if len(self._frames) < size:
                return
            frame = bytes(self._frames[:size])
            del self._frames[:size]
            if not self._allowed():
                self._abort("sends requests too fast")
                return
            super().data_received(frame)
            if self.transport.is_closing():
                return

    def _allowed(self) -> bool:
        limits = self.iserver.limits
        now = time.monotonic()
        earned = (now - self._last) * limits.requests_per_second
        self._allowance = min(limits.request_burst, self._allowance + earned) - 1
        self._last = now
        return self._allowance >= 0

    def _abort(self, reason: str) -> None:
        _log.warning("%s: disconnected, %s", _host(self.peer_name), reason)
        self._frames.clear()
        if self.transport is not None:
            self.transport.abort()


class GuardedBinaryServer(BinaryServer):
    """Listens with our protocol."""

    iserver: "GuardedInternalServer"

    def _make_protocol(self) -> OPCUAProtocol:
        return GuardedProtocol(
            iserver=self.iserver,
            policies=self._policies,
            clients=self.clients,
            closing_tasks=self.closing_tasks,
            limits=self.limits,
        )


def _host(peer_name: tuple[str, int] | None) -> str:
    return str(peer_name[0]) if peer_name else "?"
