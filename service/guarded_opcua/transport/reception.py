"""The frames of one connection in their order: Hello, secure channel, then messages."""

from collections.abc import Callable
from typing import Any, Protocol

from asyncua import ua
from asyncua.common.utils import Buffer, ServiceError
from asyncua.ua import ua_binary

from guarded_opcua.binary.bounded_decoding import Budget, Reader, decode
from guarded_opcua.settings import Limits
from guarded_opcua.transport.channel import Channel
from guarded_opcua.transport.frames import HELLO, OPEN
from guarded_opcua.transport.greeting import PeerLimits, acknowledged, check
from guarded_opcua.transport.handshake import Handshake

_Codes = ua.StatusCodes


class ReceivingLine(Protocol):
    """The connection, as its reception uses it."""

    @property
    def channel(self) -> Channel:
        """The secure channel."""

    def acknowledge(self, answer: ua.Acknowledge) -> None:
        """Answer a Hello."""


class Reception:
    """Decrypts frames and joins them to messages; opens the secure channel.

    Parameters
    ----------
    line, handshake
        The connection, and what opens its secure channel.
    budget
        Returns the present bounds of decoding.
    limits
        The server's own limits.

    Attributes
    ----------
    greeted : bool
        Whether a Hello has been received, also one that is refused.
    peer_limits : PeerLimits
        The limits that the Hello named.
    """

    def __init__(
        self,
        line: ReceivingLine,
        handshake: Handshake,
        budget: Callable[[], Budget],
        limits: Limits,
    ) -> None:
        self.greeted = False
        self.peer_limits = PeerLimits()
        self._line, self._handshake = line, handshake
        self._budget, self._limits = budget, limits

    def read(self, frame: bytes) -> Any:  # noqa: ANN401 - asyncua's messages
        """Return the message that a frame completes; None if it completes none.

        Raises
        ------
        ServiceError, UaStatusCodeError, InvalidSignature
            if the frame is not allowed now, or not valid; decoding may raise any other error.
        """
        channel = self._line.channel
        body = Buffer(frame)
        header = ua_binary.header_from_binary(body)
        if header.MessageType == HELLO:
            shown = Reader(frame[header.header_size :], self._budget())
            self._greet(decode(ua.Hello, shown))
            return None
        if not self.greeted:
            raise ServiceError(_Codes.BadTcpMessageTypeInvalid)
        if header.MessageType == OPEN:
            shown = Reader(frame[header.header_size :], self._budget())
            channel.check_open_frame(decode(ua.AsymmetricAlgorithmHeader, shown), shown.left)
        elif not channel.is_open():
            raise ServiceError(_Codes.BadTcpSecureChannelUnknown)
        message = channel.receive_from_header_and_body(header, body)
        if message is not None and header.MessageType == OPEN:
            self._handshake.open_channel(message, self._budget())
        return message

    def _greet(self, hello: ua.Hello) -> None:
        if self.greeted:
            raise ServiceError(_Codes.BadTcpMessageTypeInvalid)
        self.greeted = True  # so that the peer receives the reason of a refusal
        check(hello)
        self.peer_limits = PeerLimits(hello.MaxMessageSize, hello.MaxChunkCount)
        self._line.acknowledge(acknowledged(hello, self._line.channel.limits, self._limits))
