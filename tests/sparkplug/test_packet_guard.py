"""What a broker sends is bounded before it is received, and costs a connection, not the program."""

import asyncio
import contextlib
import os
from itertools import repeat
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given, seed
from hypothesis import strategies as st

from valvemap.clock import SystemClock
from valvemap.errors import SinkLost
from valvemap.sparkplug.broker import PahoBroker, PahoSession
from valvemap.sparkplug.edge_node import EdgeNode
from valvemap.sparkplug.outbox import Outbox
from valvemap.sparkplug.packet_guard import PacketGuard, PacketHeaders, PacketRefused
from valvemap.sparkplug.sender import Sender
from valvemap.sparkplug.settings import BrokerSettings
from valvemap.sparkplug.shown import Shown

COMMANDS = "spBv1.0/G/NCMD/N"
CONNACK = b"\x20\x02\x00\x00"
MIB = 1_048_576


def remaining_length(length):
    """Encode a remaining length, MQTT 3.1.1, 2.2.3."""
    digits = []
    while True:
        length, digit = divmod(length, 128)
        digits.append(digit | 0x80 * (length > 0))
        if not length:
            return bytes(digits)


def publish(payload, qos=0, number=1):
    topic = len(COMMANDS).to_bytes(2, "big") + COMMANDS.encode()
    body = topic + (number.to_bytes(2, "big") if qos else b"") + payload
    return bytes([0x30 | qos << 1]) + remaining_length(len(body)) + body


def guarded(packets, **bounds):
    guard = PacketGuard("mqtt://h:1", **bounds)
    guard.receive(packets)
    return guard


class HostileBroker:
    """Answers as MQTT demands until a client has subscribed; then sends its pieces."""

    def __init__(self, *pieces):
        self._pieces = pieces
        self.connections = 0

    @contextlib.asynccontextmanager
    async def listening(self):
        async with await asyncio.start_server(self._serve, "127.0.0.1", 0) as server:
            yield BrokerSettings(*server.sockets[0].getsockname(), client_id="c", timeout_s=5.0)

    async def _serve(self, reader, writer):
        self.connections += 1
        with contextlib.suppress(ConnectionError, asyncio.IncompleteReadError):
            while True:
                first, body = await self._packet(reader)
                if first >> 4 == 1:
                    writer.write(CONNACK)
                if first >> 4 == 8:
                    writer.write(b"\x90\x03" + body[:2] + b"\x01")
                    for piece in self._pieces:
                        writer.write(piece)
                        await writer.drain()
        writer.close()

    async def _packet(self, reader):
        first, length, shift = (await reader.readexactly(1))[0], 0, 0
        while True:
            digit = (await reader.readexactly(1))[0]
            length |= (digit & 0x7F) << shift
            shift += 7
            if not digit & 0x80:
                return first, await reader.readexactly(length)


async def broken(*pieces):
    """Connect to a broker that sends these pieces; return our end of it and why that broke."""
    async with HostileBroker(*pieces).listening() as settings:
        broker = PahoBroker(settings)
        with pytest.raises(SinkLost) as raised:
            await listen(broker)
        return broker, raised.value


async def listen(broker):
    session = await broker.connect(EdgeNode("G", "N").will(0), [COMMANDS])
    try:
        async with asyncio.timeout(20):
            while True:
                session.received()
                await asyncio.sleep(0.01)
    finally:
        await session.close()


def rss():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


async def highest_rss(done):
    """The most memory that the process has until the event is set."""
    highest = rss()
    while not done.is_set():
        highest = max(highest, rss())
        await asyncio.sleep(0.002)
    return highest


@seed(1)
@given(
    st.lists(st.tuples(st.sampled_from([0x20, 0x30, 0x40, 0xD0]), st.integers(0, 20_000))),
    st.integers(1, 40_000),
)
def test_headers_are_found_however_the_bytes_are_cut(packets, size):
    stream = b"".join(bytes([f]) + remaining_length(n) + b"\xff" * n for f, n in packets)
    headers = PacketHeaders()
    pieces = (stream[at : at + size] for at in range(0, len(stream), size))
    assert [found for piece in pieces for found in headers.feed(piece)] == packets


def test_a_packet_of_the_largest_size_passes_and_one_byte_more_does_not():
    guarded(b"\x30" + remaining_length(1_000), largest=1_000)
    with pytest.raises(PacketRefused, match=r"mqtt://h:1: .* 1001 bytes; 1000 are allowed"):
        guarded(b"\x30" + remaining_length(1_001), largest=1_000)


def test_a_length_that_never_ends_is_refused():
    with pytest.raises(PacketRefused, match="more than four bytes"):
        guarded(b"\x30\xff\xff\xff\xff\x01")


def test_a_message_of_qos_2_is_refused_it_was_granted_to_nobody():
    with pytest.raises(PacketRefused, match="QoS 2"):
        guarded(publish(b"", qos=2))


def test_a_broker_that_reads_its_answers_may_ask_for_ever_and_one_that_does_not_is_refused():
    guard = PacketGuard("mqtt://h:1", most_unread=5)
    for _ in range(100):
        guard.receive(publish(b"", qos=1) + b"\xc0\x00")
        guard.send(b"\x40\x02\x00\x01\xd0\x00")
    with pytest.raises(PacketRefused, match="read none of 5 answers"):
        guard.receive(publish(b"", qos=1) * 6)


async def test_a_publish_of_200_mb_takes_no_memory_and_is_named():
    size = 200_000_000
    header = b"\x30" + remaining_length(size)
    await broken(header)  # what a first connection loads
    before, done = rss(), asyncio.Event()
    watching = asyncio.create_task(highest_rss(done))
    piece = bytes(65_536)
    broker, reason = await broken(header, *repeat(piece, size // len(piece)))
    done.set()
    assert await watching - before <= 16 * MIB
    assert "a packet of 200000000 bytes; 1048576 are allowed" in str(reason)
    assert broker.refused_packets == 1


async def test_a_flood_of_packets_within_the_bound_takes_no_memory_either():
    hostile = HostileBroker(*repeat(publish(bytes(60_000)), 1_000))
    async with hostile.listening() as settings:
        session = await PahoBroker(settings).connect(EdgeNode("G", "N").will(0), [COMMANDS])
        try:
            before, done = rss(), asyncio.Event()
            watching = asyncio.create_task(highest_rss(done))
            await asyncio.sleep(1.0)  # no received()
            done.set()
            assert await watching - before <= 16 * MIB
            assert 0 < len(session.received()) <= 100
        finally:
            await session.close()


async def test_a_flood_of_one_filter_takes_no_room_of_another_and_is_counted():
    state, devices = "spBv1.0/STATE/SCADA", "spBv1.0/G/DCMD/N/+"
    settings = BrokerSettings("h", 1, client_id="c")
    broker = PahoBroker(settings)
    guard, topics = PacketGuard("mqtt://h:1"), [COMMANDS, state, devices]
    session = PahoSession(SimpleNamespace(), settings, topics, guard, broker)

    def receive(topic, payload=b"", *, retain=False):
        message = SimpleNamespace(topic=topic, payload=payload, qos=0, retain=retain)
        session._on_message(None, None, message)

    receive(state, b"{}", retain=True)
    for k in range(1_000):
        receive("spBv1.0/G/DCMD/N/V1", str(k).encode())
    receive("spBv1.0/G/DCMD/N/V1", bytes(65_537))
    receive("spBv1.0/other/DCMD/N/V1")
    heard = session.received()
    assert (heard[0].topic, heard[0].retained) == (state, True)
    assert [message.payload for message in heard[1:]] == [b"%d" % k for k in range(900, 1_000)]
    assert broker.lost_messages == 902


async def test_the_sender_counts_a_refused_packet_and_tries_again():
    hostile = HostileBroker(b"\x30" + remaining_length(200_000_000))
    async with hostile.listening() as settings:
        clock, outbox = SystemClock(), Outbox(100)
        shown = Shown(outbox, clock.now())
        paused = []

        def pauses():
            for pause in repeat(0.01):
                paused.append(pause)
                yield pause

        sender = Sender(
            PahoBroker(settings), EdgeNode("G", "N"), shown, outbox, 0.02, clock, pauses
        )
        sending = asyncio.create_task(sender.run())
        try:
            async with asyncio.timeout(20):
                while shown.newest["MQTT.Refused"].value < 2:  # noqa: ASYNC110 - polled
                    await asyncio.sleep(0.01)
        finally:
            sending.cancel()
            await asyncio.gather(sending, return_exceptions=True)
    assert hostile.connections >= 2
    assert len(paused) >= 2
