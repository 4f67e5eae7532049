"""The requests of one connection: decoded within bounds, and answered."""

from typing import Any, Final, Protocol

from asyncua import ua
from asyncua.common.utils import ServiceError

from guarded_opcua.binary.bounded_decoding import Budget, Reader, decode, decode_slowly
from guarded_opcua.logs import bounded_logger
from guarded_opcua.sessions.requests import Request
from guarded_opcua.sessions.session import Line
from guarded_opcua.transport.handshake import Handshake
from guarded_opcua.transport.shared import Shared
from guarded_opcua.turn import Turn

_log = bounded_logger(__name__)
_Codes = ua.StatusCodes

_ERRORS_FORGIVEN: Final = 20
_CLOSE_CHANNEL = ua.ObjectIds.CloseSecureChannelRequest_Encoding_DefaultBinary


class AnsweringLine(Line, Turn, Protocol):
    """The connection, as answers use it."""

    def respond(self, request_id: int, handle: int, response: Any) -> None:  # noqa: ANN401
        """Send a response, or a fault if it exceeds the peer's maximum size."""


class Answers:
    """Answers the requests of one connection.

    Attributes
    ----------
    idle_since : float
        Monotonic time of the last request of a session, s.
    """

    def __init__(self, shared: Shared, handshake: Handshake, line: AnsweringLine) -> None:
        self.idle_since = shared.clock.monotonic()
        self._shared, self._handshake, self._line = shared, handshake, line
        self._limits = shared.limits
        self._errors = 0
        self._requests_before_session = 0

    async def serve(self, message: ua.Message) -> bool:
        """Answer a request; return whether the connection stays open."""
        request_id = message.SequenceHeader().RequestId
        body = Reader(bytes(message.body()), self.budget())
        self._shared.traffic.requests += 1
        service = decode(ua.NodeId, body)
        header = decode(ua.RequestHeader, body)
        number = service.Identifier if service.NamespaceIndex == 0 else None
        if number == _CLOSE_CHANNEL:
            return False
        try:
            response = await self._answer(number, request_id, header, body)
        except (ServiceError, ua.UaStatusCodeError) as error:
            self._refused(request_id, header, error.code)
            return self._forgiven(error.code)
        except Exception:  # noqa: BLE001 - a fault is the answer
            _log.exception("%s: request %s failed", self._line.host, number)
            self._refused(request_id, header, _Codes.BadInternalError)
            return True
        if response is not None:
            self._line.respond(request_id, header.RequestHandle, response)
        return True

    async def _answer(
        self,
        service: Any,  # noqa: ANN401 - whatever a peer sends
        request_id: int,
        header: ua.RequestHeader,
        body: Reader,
    ) -> Any:  # noqa: ANN401 - any response
        if self._handshake.answers(service):
            if not self._handshake.done:
                self._requests_before_session += 1
                if self._requests_before_session > self._limits.handshake_messages:
                    raise ServiceError(_Codes.BadTcpServerTooBusy)
            return await self._handshake.answer(service, header, body)
        session = self._handshake.session_of(header)
        services = self._shared.services
        self.idle_since = self._shared.clock.monotonic()
        session.touch()
        kind = services.parameters(service)
        params = await decode_slowly(kind, body, self._line.breathe)
        request = Request(session, request_id, header, self._line)
        return await services.answer(service, request, params)

    def _refused(self, request_id: int, header: ua.RequestHeader, code: int) -> None:
        self._shared.traffic.count_refusal(code)
        self._line.refuse(request_id, header.RequestHandle, code)

    def _forgiven(self, code: int) -> bool:
        if code in (_Codes.BadDecodingError, _Codes.BadEncodingLimitsExceeded):
            self._errors += 1
        return self._errors <= _ERRORS_FORGIVEN

    def budget(self) -> Budget:
        """Return the bounds of decoding: narrow ones before a session is active."""
        limits = self._limits
        if not self._handshake.done:
            return Budget(1_000, 1_000, limits.handshake_bytes, 8)
        return Budget(limits.elements, limits.array_length, limits.string_bytes, limits.nesting)
