"""The first message of a connection: sizes of messages and buffers of both (Part 6, 7.1.2)."""

from dataclasses import dataclass
from typing import Final

from asyncua import ua
from asyncua.common.connection import TransportLimits
from asyncua.common.utils import ServiceError

from guarded_opcua.settings import Limits

_SMALLEST_BUFFER: Final = 8_192  # Part 6, 7.1.2.3


@dataclass(frozen=True)
class PeerLimits:
    """The largest message that the peer takes, bytes, and its chunks; 0: it has not said."""

    message_bytes: int = 0
    chunks: int = 0

    def permit(self, size: int, buffer: int) -> bool:
        """Whether the peer takes a message of this size in chunks of ``buffer`` bytes."""
        if self.message_bytes and size > self.message_bytes:
            return False
        return not self.chunks or size <= self.chunks * (buffer - 256)


def check(hello: ua.Hello) -> None:
    """Check what a peer asks for.

    Raises
    ------
    ServiceError
        BadConnectionRejected.
    """
    smallest = min(hello.ReceiveBufferSize, hello.SendBufferSize)
    if smallest < _SMALLEST_BUFFER or len(hello.EndpointUrl or "") > 4_096:
        raise ServiceError(ua.StatusCodes.BadConnectionRejected)


def acknowledged(hello: ua.Hello, buffers: TransportLimits, own: Limits) -> ua.Acknowledge:
    """Return the answer; ``buffers`` shrink to those of the peer."""
    buffers.max_send_buffer = min(hello.ReceiveBufferSize, buffers.max_send_buffer)
    buffers.max_recv_buffer = min(hello.SendBufferSize, buffers.max_recv_buffer)
    return ua.Acknowledge(
        ProtocolVersion=0,
        ReceiveBufferSize=buffers.max_recv_buffer,
        SendBufferSize=buffers.max_send_buffer,
        MaxMessageSize=own.message_bytes,
        MaxChunkCount=own.chunks,
    )
