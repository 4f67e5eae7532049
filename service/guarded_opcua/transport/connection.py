"""One TCP connection: frames, secure channel, sessions; limits before authentication."""

import asyncio
from collections.abc import Awaitable
from functools import partial
from typing import Any, Protocol, TypeVar

from asyncua import ua
from asyncua.common.connection import TransportLimits
from asyncua.common.utils import ServiceError
from asyncua.crypto.uacrypto import InvalidSignature
from asyncua.ua import ua_binary

from guarded_opcua.allowance import Allowance
from guarded_opcua.binary.encoding import encode_publish_response, ticks_of_ns
from guarded_opcua.logs import bound_asyncua, bounded_logger
from guarded_opcua.subscriptions.publish_queue import PublishRequest
from guarded_opcua.subscriptions.subscription import Message
from guarded_opcua.transport.answering import Answers
from guarded_opcua.transport.channel import Channel
from guarded_opcua.transport.fair_turns import Cost
from guarded_opcua.transport.frames import CLOSE, MESSAGE, Frames
from guarded_opcua.transport.handshake import Handshake
from guarded_opcua.transport.reception import Reception
from guarded_opcua.transport.shared import Shared

_log = bounded_logger(__name__)
T = TypeVar("T")
_Codes = ua.StatusCodes

_BYTES_PER_REQUEST = 16 * 1024  # a larger request or response consumes one more unit per 16 KiB


class Door(Protocol):
    """Admits connections and monitors them; implemented by the listener."""

    def admit(self, connection: "Connection") -> bool:
        """Return whether a new connection is admitted."""

    def forget(self, connection: "Connection") -> None:
        """Remove a closed connection."""

    def sent(self, connection: "Connection") -> None:
        """Check the send buffers after data was sent."""


class Connection(asyncio.BufferedProtocol):
    """Parses frames and answers requests sequentially, scheduled fairly with other connections."""

    def __init__(self, shared: Shared, door: Door) -> None:
        self.host = "?"
        self.cost = Cost(earned_until=shared.clock.monotonic())
        self.writable = True
        self.since = shared.clock.monotonic()
        self.blocked_since: float | None = None
        self.channel: Channel
        self.transport: asyncio.Transport
        self._shared = shared
        self._door = door
        self._limits = shared.limits
        self._frames = Frames()
        self._arrived = asyncio.Event()
        self._writable_again = asyncio.Event()
        self._paused = False
        self._before_session = 0
        self._allowance = Allowance(
            shared.clock, self._limits.allowed_requests_per_second, self._limits.request_burst
        )
        self._task: asyncio.Task[None] | None = None
        self._handshake = Handshake(shared, self)
        self._answers = Answers(shared, self._handshake, self)
        self._reception = Reception(self, self._handshake, self._answers.budget, self._limits)

    @property
    def peer_certificate(self) -> bytes | None:
        """Certificate of the secure channel (DER), None without security."""
        return self.channel.peer_certificate

    @property
    def idle_since(self) -> float:
        """Monotonic time of the last request of a session, s."""
        return self._answers.idle_since

    @property
    def progress(self) -> int:
        """Progress of the handshake: 0 connected, 1 Hello received, 2 secure channel open."""
        return self._reception.greeted + self.channel.is_open()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Start serving, unless the connection is not admitted."""
        assert isinstance(transport, asyncio.Transport)  # noqa: S101 - TCP gives nothing else
        self.transport = transport
        name = transport.get_extra_info("peername")
        self.host = str(name[0]) if name else "?"
        limits = self._limits
        if not self._door.admit(self):
            transport.abort()
            return
        transport.set_write_buffer_limits(high=limits.unsent_bytes_per_connection)
        self.channel = Channel(
            TransportLimits(
                max_recv_buffer=limits.chunk_bytes,
                max_send_buffer=limits.chunk_bytes,
                max_chunk_count=limits.chunks,
                max_message_size=limits.handshake_bytes,
            ),
            self._shared.own.policies,
            self._shared.trust,
            partial(self._shared.audit.certificate_refused, self.host),
            self._shared.clock,
        )
        self._task = asyncio.create_task(self._run())

    def connection_lost(self, _: Exception | None) -> None:
        """Stop serving; sessions continue until their time-out."""
        if self._task is not None:
            self._task.cancel()
        self._frames.clear()
        self._door.forget(self)

    def pause_writing(self) -> None:
        """Stop answering and publishing: the send buffer is full."""
        self.writable = False
        self.blocked_since = self._shared.clock.monotonic()
        self._writable_again.clear()

    def resume_writing(self) -> None:
        """Resume answering and publishing: the peer has read enough of the buffer."""
        self.writable = True
        self.blocked_since = None
        self._writable_again.set()
        for session in self._shared.sessions:
            if session.line is self:
                session.queue.serve()  # late subscriptions

    def get_buffer(self, _: int) -> memoryview:
        """Return the shared receive buffer; it is small, so that no peer blocks the event loop."""
        return self._shared.arrivals

    def buffer_updated(self, count: int) -> None:
        """Split received bytes into frames; close the connection on invalid or oversized ones."""
        if self.transport.is_closing():
            return
        data = self._shared.arrivals[:count]
        if not self._handshake.done:
            self._before_session += len(data)
            if self._before_session > self._limits.handshake_bytes:
                self.fail(_Codes.BadTcpMessageTooLarge, "sends too much before it logs in")
                return
        if not self._frames.add(data, self.channel.limits.max_recv_buffer):
            self.fail(_Codes.BadTcpMessageTypeInvalid, "sends no OPC UA, or too large a frame")
            return
        if self._frames:
            self._arrived.set()
        if self._frames.are_many and not self._paused:
            self._paused = True
            self.transport.pause_reading()

    def fail(self, code: int, reason: str) -> None:
        """Send an error message with the reason, and close."""
        if self.transport.is_closing():
            return
        _log.warning("%s: disconnected: %s", self.host, reason)
        if self._reception.greeted and self.writable:
            error = ua.ErrorMessage(ua.StatusCode(code), None)
            self.transport.write(ua_binary.uatcp_to_binary(ua.MessageType.Error, error))
            self.transport.close()
        else:
            self.transport.abort()

    def charge(self, cost: float) -> None:
        """Charge processor time to the connection, s."""
        self.cost.spend(cost)

    def answer_publish(self, request: PublishRequest, number: int, message: Message) -> None:
        """Send a publish response."""
        now = ticks_of_ns(self._shared.clock.now())
        response = encode_publish_response(
            request.handle,
            now,
            number,
            message.available,
            message.more,
            message.content,
            request.results,
        )
        self._send(request.request_id, response)

    def refuse(self, request_id: int, handle: int, code: int) -> None:
        """Send a fault."""
        response = ua.ServiceFault()
        response.ResponseHeader.RequestHandle = handle
        response.ResponseHeader.ServiceResult = ua.StatusCode(code)
        self._send(request_id, ua_binary.struct_to_binary(response))

    def respond(self, request_id: int, handle: int, response: Any) -> None:  # noqa: ANN401
        """Send a response, or a fault if it exceeds the peer's maximum size."""
        if not isinstance(response, bytes):
            response.ResponseHeader.RequestHandle = handle
            response = ua_binary.struct_to_binary(response)
        size, buffer = len(response), self.channel.limits.max_send_buffer
        permitted = self._reception.peer_limits.permit(size, buffer)
        if size > self._limits.response_bytes or not permitted:
            self.refuse(request_id, handle, _Codes.BadResponseTooLarge)
        else:
            self._allowance.spend(size / _BYTES_PER_REQUEST)
            self._send(request_id, response)

    async def breathe(self) -> None:
        """Yield to other connections if this request has used its time slice."""
        if self._shared.turns.costs_more_than(self._limits.turn_s):
            self._shared.turns.give(self.cost)
            await asyncio.sleep(0)
            await self._shared.turns.take(self.cost)

    async def outside(self, slow: Awaitable[T]) -> T:
        """Await a slow operation with the turn released."""
        self._shared.turns.give(self.cost)
        try:
            return await slow
        finally:
            await self._shared.turns.take(self.cost)

    def acknowledge(self, answer: ua.Acknowledge) -> None:
        """Answer a Hello."""
        self.transport.write(ua_binary.uatcp_to_binary(ua.MessageType.Acknowledge, answer))

    def send_open(self, request_id: int, response: ua.OpenSecureChannelResponse) -> None:
        """Answer an OpenSecureChannel."""
        content = ua_binary.struct_to_binary(response)
        kind = ua.MessageType.SecureOpen
        self.transport.write(self.channel.message_to_binary(content, kind, request_id))

    def log_in(self) -> None:
        """Apply the limits of authenticated users."""
        self.channel.limits.max_message_size = self._limits.message_bytes

    async def _run(self) -> None:
        bound_asyncua()
        while True:
            while not self._frames:
                self._arrived.clear()
                self._resume_reading()
                await self._arrived.wait()
            while not self.writable:
                await self._writable_again.wait()
            if not self._allowance.covers(1.0 + self._frames.next_size / _BYTES_PER_REQUEST):
                await self._shared.clock.sleep(1.0 / self._limits.allowed_requests_per_second)
                continue
            await self._shared.turns.take(self.cost)
            try:
                keep = await self._process(self._frames.take())
            finally:
                self._shared.turns.give(self.cost)
            if not keep:
                self.transport.close()
                return
            await asyncio.sleep(0)

    async def _process(self, frame: bytes) -> bool:
        try:
            message = self._reception.read(frame)
            if message is None:
                return True
            if isinstance(message, ua.Message) and frame[:3] == MESSAGE:
                return await self._answers.serve(message)
            return frame[:3] != CLOSE
        except (ServiceError, ua.UaStatusCodeError) as error:
            self.fail(error.code, ua.StatusCode(error.code).name)
        except InvalidSignature:
            self.fail(_Codes.BadSecurityChecksFailed, "wrong signature")
        except Exception as error:  # noqa: BLE001 - an error in a peer's data must not propagate
            reason = f"cannot be understood: {type(error).__name__}"
            self.fail(_Codes.BadSecurityChecksFailed, reason)
        return True

    def _send(self, request_id: int, response: bytes) -> None:
        if self.transport.is_closing():
            return
        data = self.channel.message_to_binary(response, ua.MessageType.SecureMessage, request_id)
        self.transport.write(data)
        self._door.sent(self)

    def _resume_reading(self) -> None:
        if self._paused and not self.transport.is_closing():
            self._paused = False
            self.transport.resume_reading()
