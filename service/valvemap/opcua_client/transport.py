"""The transport of our client: asyncua's, with a bounded receive path.

The header of a frame is validated before the frame is buffered, and its content is decoded within
a budget. An invalid message ends the connection; every pending request fails with the reason.

Private seams of asyncua: ``UaClient._make_protocol`` and ``_send_request``; ``UASocketProtocol``'s
``_connection``, ``_callbackmap``, ``_call_callback``, ``_fail_all_pending``, ``_request_id`` and
``_send_request``; ``SecureConnection._receive``, ``_incoming_parts`` and ``_incoming_size``.
"""

import asyncio
from dataclasses import dataclass

from asyncua import ua
from asyncua.client.ua_client import UaClient, UASocketProtocol, UASocketState
from asyncua.common.connection import MessageChunk, SecureConnection, TransportLimits
from asyncua.common.utils import Buffer
from asyncua.crypto.security_policies import SecurityPolicy
from asyncua.ua import ua_binary
from typing_extensions import override

from valvemap.opcua_client.responses import Senseless, check_fault, decode_part, decode_response

MESSAGE_BYTES = 8 * 1024 * 1024
"""Largest message: 100,000 notifications of 83 bytes, twice what a number takes at most."""

_CHUNKS = 2_048  # of one message; with chunks of 8 KiB, the smallest size, more than MESSAGE_BYTES
_CHUNK_BYTES = 1024 * 1024
_SENT_CHUNK_BYTES = 65_535  # commonly accepted by servers
_SMALLEST_BUFFER = 8_192  # Part 6, 7.1.2.3
_OPEN_BYTES = 24 * 1024  # each 256 bytes cost an RSA decryption
_WORD_BYTES = 8 * 1024  # of an Acknowledge or an Error, which holds one sentence
_HEADER_BYTES, _SECURED_HEADER_BYTES = 8, 12
_MOST_BYTES = {b"ACK": _WORD_BYTES, b"ERR": _WORD_BYTES, b"OPN": _OPEN_BYTES, b"MSG": _CHUNK_BYTES}
_WHOLE, _CHUNK_KINDS = b"F", (b"F", b"C", b"A")
_HELLO = 0  # asyncua's request id of Hello


class BoundedClient(UaClient):
    """asyncua's transport and discovery, over a :class:`BoundedProtocol`."""

    async def call(self, request: object, *, timeout: float | None = None) -> bytes:  # noqa: ASYNC109 - asyncua's way
        """Send a request and return the response's body from its TypeId on."""
        try:
            return await self._send_request(request, timeout)
        except asyncio.CancelledError as cancelled:
            if type(cancelled) is asyncio.CancelledError:
                raise
            # wait_for2 has a separate kind, which `asyncio.timeout` of Python 3.11 does not take
            # for the end of its time
            raise asyncio.CancelledError from None

    @override
    async def get_endpoints(
        self, params: ua.GetEndpointsParameters
    ) -> list[ua.EndpointDescription]:
        request = ua.GetEndpointsRequest()
        request.Parameters = params
        response = decode_response(ua.GetEndpointsResponse, await self.call(request))
        return response.Endpoints

    @override
    def _make_protocol(self) -> UASocketProtocol:
        protocol = BoundedProtocol(self._timeout, self.security_policy)
        protocol.pre_request_hook = self.pre_request_hook
        protocol.on_connection_lost = self._on_transport_lost
        protocol.is_session_closing = self._is_session_closing
        self.protocol = protocol
        return protocol


class BoundedProtocol(UASocketProtocol):
    """Receives frames of an untrusted server."""

    def __init__(self, timeout: float, security_policy: SecurityPolicy) -> None:
        super().__init__(timeout, security_policy)
        self._limits = TransportLimits(_CHUNK_BYTES, _SENT_CHUNK_BYTES, _CHUNKS, MESSAGE_BYTES)
        self._connection = _Channel(security_policy, self._limits)
        self._arrived = bytearray()
        self._opening: _Opening | None = None

    @override
    def data_received(self, data: bytes) -> None:
        self._arrived += data
        try:
            while len(self._arrived) >= _HEADER_BYTES:
                size = _size_of_frame(bytes(self._arrived[:_HEADER_BYTES]))
                if len(self._arrived) < size:
                    return
                frame = bytes(self._arrived[:size])
                del self._arrived[:size]
                self._take(frame)
        except ua.UaError as error:
            self._give_up(error)
        except Exception as error:  # noqa: BLE001 - whatever a server sends must not get further
            self._give_up(Senseless(f"a message that makes no sense ({type(error).__name__})"))

    @override
    async def send_hello(
        self, url: str, max_messagesize: int = 0, max_chunkcount: int = 0
    ) -> ua.Acknowledge:
        hello = ua.Hello(0, _CHUNK_BYTES, _SENT_CHUNK_BYTES, MESSAGE_BYTES, _CHUNKS, url)
        answer = self._callbackmap[_HELLO] = asyncio.get_running_loop().create_future()
        if self.transport is None:
            raise ConnectionError("Connection is not open")
        self.transport.write(ua_binary.uatcp_to_binary(ua.MessageType.Hello, hello))
        return await asyncio.wait_for(answer, self.timeout)

    @override
    async def open_secure_channel(
        self, params: ua.OpenSecureChannelParameters
    ) -> ua.OpenSecureChannelResult:
        if self._opening is not None:
            raise ua.UaError("the channel is already being opened")
        request = ua.OpenSecureChannelRequest()
        request.Parameters = params
        answer = self._send_request(request, message_type=ua.MessageType.SecureOpen)
        self._opening = _Opening(self._request_id, params)
        return await asyncio.wait_for(answer, self.timeout)

    @override
    def check_answer(self, data: bytes, context: str) -> bool:
        check_fault(data)
        return True

    def _take(self, frame: bytes) -> None:
        match frame[:3]:
            case b"ACK":
                self._greeted(decode_part(ua.Acknowledge, frame[_HEADER_BYTES:]))
            case b"ERR":
                raise _refusal(decode_part(ua.ErrorMessage, frame[_HEADER_BYTES:]))
            case b"OPN" if self._opening is not None:
                decode_part(ua.AsymmetricAlgorithmHeader, frame[_SECURED_HEADER_BYTES:])
                self._opened(self._opening, *self._unpacked(frame))
            case b"MSG" if self._connection.is_open():
                number, body = self._unpacked(frame)
                if number:
                    self._answered(number, body)
            case _:
                raise Senseless("a message out of turn")

    def _unpacked(self, frame: bytes) -> tuple[int, bytes]:
        """Return request id and body of a message; id 0 if the next frame continues it."""
        buffer = Buffer(frame)
        header = ua_binary.header_from_binary(buffer)
        message = self._connection.receive_from_header_and_body(header, buffer)
        if message is None:
            return 0, b""
        number = message.request_id()
        if number not in self._callbackmap or number == _HELLO:
            raise Senseless("a response to no request")
        return number, bytes(message.body())

    def _greeted(self, acknowledge: ua.Acknowledge) -> None:
        if _HELLO not in self._callbackmap:
            raise Senseless("a message out of turn")
        if acknowledge.ReceiveBufferSize < _SMALLEST_BUFFER:
            raise Senseless(f"that it takes only {acknowledge.ReceiveBufferSize} bytes at once")
        self._limits.max_send_buffer = min(acknowledge.ReceiveBufferSize, _SENT_CHUNK_BYTES)
        self._call_callback(_HELLO, acknowledge)

    def _opened(self, opening: "_Opening", number: int, body: bytes) -> None:
        if number != opening.number:
            raise Senseless("a message out of turn")
        check_fault(body)
        response = decode_response(ua.OpenSecureChannelResponse, body)
        wish = opening.parameters
        self._opening = None
        self._connection.set_channel(response.Parameters, wish.RequestType, wish.ClientNonce)
        self._call_callback(number, response.Parameters)

    def _answered(self, number: int, body: bytes) -> None:
        if self._opening is not None and number == self._opening.number:
            raise Senseless("a message out of turn")
        self._call_callback(number, body)

    def _give_up(self, error: ua.UaError) -> None:
        """Abort the connection; every pending request fails with ``error``."""
        self._arrived.clear()
        self.state = UASocketState.CLOSED
        if self.transport is not None:
            self.transport.abort()
        self._fail_all_pending(error)


class _Channel(SecureConnection):
    """A secure channel that limits the chunks and bytes of a message."""

    @override
    def _receive(self, msg: MessageChunk) -> ua.Message | None:
        if msg.MessageHeader.ChunkType == ua.ChunkType.Abort:
            raise _refusal(decode_part(ua.ErrorMessage, msg.Body))
        if len(self._incoming_parts) >= _CHUNKS:
            raise Senseless(f"a message of more than {_CHUNKS} chunks")
        if self._incoming_size + len(msg.Body) > MESSAGE_BYTES:
            raise Senseless(f"a message of more than {MESSAGE_BYTES} bytes")
        return super()._receive(msg)


@dataclass(frozen=True)
class _Opening:
    """A pending OpenSecureChannel request."""

    number: int
    parameters: ua.OpenSecureChannelParameters


def _size_of_frame(header: bytes) -> int:
    """Return the size of a frame from its first 8 bytes; raise Senseless if it is not allowed."""
    kind, chunk, size = header[:3], header[3:4], int.from_bytes(header[4:], "little")
    if kind not in _MOST_BYTES or chunk not in _CHUNK_KINDS or (chunk != _WHOLE and kind != b"MSG"):
        raise Senseless("no OPC UA")
    if not _SECURED_HEADER_BYTES <= size <= _MOST_BYTES[kind]:
        raise Senseless(f"a frame that claims to have {size} bytes")
    return size


def _refusal(error: ua.ErrorMessage) -> ua.UaError:
    """Return the exception for an Error message or an aborted chunk sequence."""
    code = error.Error.value
    return ua.UaStatusCodeError(code if code >> 31 else ua.StatusCodes.BadUnexpectedError)
