"""MQTT 3.1.1 by Eclipse Paho: each connection has its own client and thread."""

import asyncio
import socket
import ssl
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from threading import Lock
from typing import Any, Final

from paho.mqtt.client import MQTT_ERR_SUCCESS, Client, MQTTv311, topic_matches_sub
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.reasoncodes import ReasonCode

from valvemap.daemon_thread import in_daemon_thread
from valvemap.errors import SinkError, SinkLost, SinkRejected
from valvemap.sparkplug.edge_node import Message
from valvemap.sparkplug.guarded_client import GuardedClient
from valvemap.sparkplug.packet_guard import PacketGuard
from valvemap.sparkplug.settings import BrokerSettings
from valvemap.sparkplug.tls import tls_context, words_of

_MOST_RECEIVED: Final = (
    100  # messages; capacity of a filter's receive buffer, which drops the oldest
)
_LARGEST: Final = 65_536  # bytes; larger payloads are neither a command nor a STATE message
_FAREWELL_S: Final = 2.0
_SERVER_UNAVAILABLE: Final = "Server unavailable"  # the only refusal to retry after


class PahoBroker:
    """Implements :class:`valvemap.sparkplug.ports.Broker`.

    Raises
    ------
    ConfigurationError
        if a certificate or key cannot be loaded; names the file.
    """

    def __init__(self, settings: BrokerSettings) -> None:
        self._settings = settings
        self._tls = tls_context(settings) if settings.tls else None
        self.refused_packets = 0
        self.lost_messages = 0

    @property
    def url(self) -> str:
        """URL of the broker."""
        return self._settings.url

    async def connect(self, will: Message, topics: Sequence[str]) -> "PahoSession":
        """Connect with a will, and subscribe to the topics.

        Raises
        ------
        SinkLost
            if the broker cannot be reached.
        SinkRejected
            if it refuses the connection, or its certificate is not trusted.
        """
        settings = self._settings
        guard = PacketGuard(settings.url)
        client = GuardedClient(
            guard,
            CallbackAPIVersion.VERSION2,
            client_id=settings.client_id,
            clean_session=True,
            protocol=MQTTv311,
            reconnect_on_failure=False,  # each connection needs a new will
        )
        client.connect_timeout = settings.timeout_s
        client.will_set(will.topic, will.payload, qos=will.qos, retain=False)
        if settings.user is not None:
            client.username_pw_set(settings.user, settings.password)
        if self._tls is not None:
            client.tls_set_context(self._tls)
        session = PahoSession(client, settings, topics, guard, self)
        try:
            await session.begin()
        except BaseException:
            await session.close()
            raise
        return session


class PahoSession:
    """Implements :class:`valvemap.sparkplug.ports.Session`; made by :class:`PahoBroker`."""

    def __init__(
        self,
        client: Client,
        settings: BrokerSettings,
        topics: Sequence[str],
        guard: PacketGuard,
        counts: PahoBroker,
    ) -> None:
        self._client, self._settings, self._topics = client, settings, topics
        self._guard, self._counts = guard, counts
        self._loop = asyncio.get_running_loop()
        self._accepted: asyncio.Future[bool] = self._loop.create_future()
        self._confirmed: dict[int, asyncio.Future[bool]] = {}
        self._received: dict[str, deque[Message]] = {
            topic: deque(maxlen=_MOST_RECEIVED) for topic in topics
        }
        self._receiving = Lock()
        self._failure: SinkError | None = None
        self._ended = asyncio.Event()
        client.on_connect = self._on_connect
        client.on_disconnect = self._on_disconnect
        client.on_subscribe = self._on_subscribe
        client.on_message = self._on_message

    async def begin(self) -> None:
        """Connect, wait for CONNACK and subscribe."""
        settings = self._settings
        try:
            await in_daemon_thread(
                lambda: self._client.connect(settings.host, settings.port, settings.keep_alive_s)
            )
        except ssl.SSLError as error:
            raise SinkRejected(f"{settings.url}: {words_of(error)}") from error
        except (OSError, ValueError) as error:
            raise SinkLost(f"{settings.url}: {words_of(error)}") from error
        self._client.loop_start()
        await self._wait(self._accepted, "it does not take the connection")
        if not self._guard.received:  # the size of packets would be unbounded
            raise SinkRejected("this version of paho-mqtt bypasses the packet guard")
        for topic in self._topics:
            await self._subscribe(topic)

    def publish(self, message: Message) -> None:
        """Publish without waiting."""
        self._check()
        sent = self._client.publish(message.topic, message.payload, qos=message.qos)
        if sent.rc != MQTT_ERR_SUCCESS:
            raise SinkLost(f"{self._settings.url}: not connected")

    async def confirm(self) -> None:
        """Wait until the broker has received everything published so far.

        The broker processes packets in order and answers SUBSCRIBE with SUBACK. A second SUBSCRIBE
        to the command topic therefore confirms all packets sent before it.
        """
        await self._subscribe(self._topics[0])

    def received(self) -> list[Message]:
        """Return the messages received since the last call."""
        self._check()
        with self._receiving:
            found = [message for some in self._received.values() for message in some]
            for some in self._received.values():
                some.clear()
        return found

    async def close(self) -> None:
        """Disconnect; idempotent, also after a loss."""
        if self._client.disconnect() == MQTT_ERR_SUCCESS:
            with suppress(TimeoutError):
                await asyncio.wait_for(self._ended.wait(), _FAREWELL_S)
        connected = self._client.socket()
        if isinstance(connected, socket.socket):
            with suppress(OSError):
                connected.shutdown(socket.SHUT_RDWR)
        await in_daemon_thread(self._client.loop_stop)
        self._client._reset_sockets()  # noqa: SLF001 - else its own pair waits for the collector

    async def _subscribe(self, topic: str) -> None:
        self._check()
        result, number = self._client.subscribe(topic, qos=1)
        if result != MQTT_ERR_SUCCESS or number is None:
            raise SinkLost(f"{self._settings.url}: not connected")
        answer = self._confirmed[number] = self._loop.create_future()
        try:
            if not await self._wait(answer, "it is silent"):
                raise SinkRejected(f"{self._settings.url}: it lets us not listen to {topic}")
        finally:
            self._confirmed.pop(number, None)

    def _check(self) -> None:
        if self._failure is not None:
            raise self._failure

    async def _wait(self, answer: asyncio.Future[bool], else_: str) -> bool:
        self._check()
        try:
            return await asyncio.wait_for(answer, self._settings.timeout_s)
        except TimeoutError:
            seconds = self._settings.timeout_s
            raise SinkLost(f"{self._settings.url}: {else_} for {seconds:g} s") from None

    def _on_connect(
        self,
        _client: Client,
        _userdata: object,
        _flags: object,
        reason: ReasonCode,
        _properties: object,
    ) -> None:
        self._soon(self._take_answer, self._accepted, reason)

    def _on_subscribe(
        self,
        _client: Client,
        _userdata: object,
        number: int,
        reasons: list[ReasonCode],
        _properties: object,
    ) -> None:
        self._soon(self._take_confirmation, number, reasons[0])

    def _on_message(self, _client: Client, _userdata: object, message: Any) -> None:  # noqa: ANN401
        """Store a message; runs in paho's thread."""
        received = Message(message.topic, message.payload, message.qos, bool(message.retain))
        matches = (t for t in self._received if topic_matches_sub(t, received.topic))
        topic = next(matches, None)
        if topic is None or len(received.payload) > _LARGEST:
            self._counts.lost_messages += 1
            return
        with self._receiving:
            some = self._received[topic]
            self._counts.lost_messages += len(some) == _MOST_RECEIVED
            some.append(received)

    def _on_disconnect(
        self,
        _client: Client,
        _userdata: object,
        _flags: object,
        reason: ReasonCode,
        _properties: object,
    ) -> None:
        self._soon(self._end, reason)

    def _take_answer(self, answer: asyncio.Future[bool], reason: ReasonCode) -> None:
        if answer.done():
            return
        if not reason.is_failure:
            answer.set_result(True)
            return
        kind = SinkLost if str(reason) == _SERVER_UNAVAILABLE else SinkRejected
        answer.set_exception(kind(f"{self._settings.url}: {reason}"))

    def _take_confirmation(self, number: int, reason: ReasonCode) -> None:
        answer = self._confirmed.get(number)
        if answer is not None and not answer.done():
            answer.set_result(not reason.is_failure)

    def _end(self, reason: ReasonCode) -> None:
        self._ended.set()
        if self._failure is None and self._guard.refusal is not None:
            self._failure = self._guard.refusal
            self._counts.refused_packets += 1
        if self._failure is None:
            self._failure = SinkLost(f"{self._settings.url}: the connection broke: {reason}")
        for answer in (self._accepted, *self._confirmed.values()):
            if not answer.done():
                answer.set_exception(self._failure)
                answer.exception()  # mark it as retrieved, if no task awaits it

    def _soon(self, call: Callable[..., object], *arguments: object) -> None:
        """Run in the event loop's thread; paho's callbacks run in its own thread."""
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(call, *arguments)
