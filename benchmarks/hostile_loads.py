"""Classes of load that a server must bear: ``python -m benchmarks.hostile_loads NAME URL SECONDS``.

Floods and slowness as any tester would write them, and packets broken at random. All speak without
security, where a peer costs a server the most before it has proven anything.
"""

import asyncio
import contextlib
import os
import random
import sys
import time

from asyncua import ua
from asyncua.ua import ua_binary

from benchmarks.worst_alarms import WORST_OF_ALARMS, operator
from benchmarks.worst_loads import WORST
from tests.support.mutations import mutated, requests
from tests.support.raw_peer import RawPeer

COUNTER, BIG = ua.NodeId("Plant.Counter", 2), ua.NodeId("Plant.Big", 2)
FUZZED_PACKETS = 10_000
VALUE = ua.AttributeIds.Value


async def connections(url, until):
    """Open connections and send nothing."""
    held = []
    while time.monotonic() < until:
        with contextlib.suppress(OSError):
            held.append(await RawPeer.connect(url))
        if len(held) > 400:
            held.pop(0).close()


async def garbage(url, until):
    """Open connections and send noise."""
    dice = random.Random(1)
    while time.monotonic() < until:
        peer = await RawPeer.connect(url)
        for _ in range(4):
            peer.writer.write(dice.choice((b"HELF", b"MSGF", b"OPNF", b"")) + dice.randbytes(2_000))
        await drained(peer)
        peer.close()


async def sessions(url, until):
    """Create sessions and never log in."""
    while time.monotonic() < until:
        peer = await RawPeer.connect(url)
        await peer.open()
        for _ in range(20):
            if time.monotonic() < until:
                await peer.create_session()


async def logins(url, until):
    """Log in again and again, and keep what can be kept."""
    held = []
    while time.monotonic() < until:
        held.append(await (await RawPeer.connect(url)).log_in())


async def passwords(url, until):
    """Guess passwords."""
    while time.monotonic() < until:
        peer = await RawPeer.connect(url)
        await peer.open()
        made = await peer.create_session()
        for number in range(10):
            if time.monotonic() >= until:
                break
            with contextlib.suppress(ua.UaError):
                await peer.activate(operator(made, f"guess {number}".encode()))
        peer.close()


async def subscriptions(url, until):
    """Create subscriptions, each as fast as can be, and modify them."""
    peer = await (await RawPeer.connect(url)).log_in()
    parameters = ua.CreateSubscriptionParameters(0.0, 10_000, 1, 0, True, 255)  # noqa: FBT003
    while time.monotonic() < until:
        for _ in range(20):
            peer.send(ua.CreateSubscriptionRequest(Parameters=parameters))
            peer.send(ua.PublishRequest())
        await drained(peer)


async def monitored_items(url, until):
    """Monitor the same nodes thousands of times."""
    peer = await (await RawPeer.connect(url)).log_in()
    number = await subscribed(peer)
    wish = ua.MonitoringParameters(1, 0.0, None, 2**32 - 1, True)  # noqa: FBT003
    items = [
        ua.MonitoredItemCreateRequest(
            ua.ReadValueId(node, VALUE), ua.MonitoringMode.Reporting, wish
        )
        for node in [COUNTER, BIG] * 400
    ]
    while time.monotonic() < until:
        request = ua.CreateMonitoredItemsRequest()
        request.Parameters = ua.CreateMonitoredItemsParameters(
            number, ua.TimestampsToReturn.Both, items
        )
        peer.send(request)
        await drained(peer)


async def publish_requests(url, until):
    """Ask for notifications thousands of times."""
    peer = await (await RawPeer.connect(url)).log_in()
    await subscribed(peer, interval=60_000.0)
    while time.monotonic() < until:
        for _ in range(100):
            peer.send(ua.PublishRequest())
        await drained(peer)


async def chunks(url, until):
    """Send messages in chunks that never end."""
    peer = await (await RawPeer.connect(url)).log_in()
    while time.monotonic() < until:
        peer.number += 1
        whole = peer.channel.message_to_binary(
            bytes(60_000), ua.MessageType.SecureMessage, peer.number
        )
        peer.writer.write(whole[:3] + b"C" + whole[4:])
        await drained(peer)


async def reads(url, until):
    """Read the largest value there is, without waiting for answers."""
    peer = await (await RawPeer.connect(url)).log_in()
    while time.monotonic() < until:
        for _ in range(20):
            peer.send(reading(BIG, 1))
        await drained(peer)


async def large_requests(url, until):
    """Ask for a thousand things at once, again and again."""
    peer = await (await RawPeer.connect(url)).log_in()
    browse = ua.BrowseRequest()
    browse.Parameters.NodesToBrowse = [ua.BrowseDescription(ua.NodeId(84))] * 1_000
    while time.monotonic() < until:
        peer.send(reading(COUNTER, 1_000))
        peer.send(browse)
        await drained(peer)


async def slow_readers(url, until):
    """Ask for much and read nothing of it."""
    peers = [await (await RawPeer.connect(url)).log_in() for _ in range(4)]
    for peer in peers:
        peer.reader._transport.pause_reading()  # noqa: SLF001 - the stream itself would read on
    while time.monotonic() < until:
        for peer in peers:
            peer.send(reading(BIG, 1))
        await asyncio.sleep(0.005)


async def broken_packets(url, _):
    """Send packets that are broken somewhere, seeded, to their number and not to a time."""
    dice = random.Random(7)
    makers = requests(COUNTER)
    shares = [random.Random(dice.random()) for _ in range(4)]
    await asyncio.gather(
        *(break_packets(url, makers, share, FUZZED_PACKETS // 4) for share in shares)
    )


async def break_packets(url, makers, dice, packets):
    peer = None
    while packets:
        try:
            if peer is None:
                peer = await (await RawPeer.connect(url)).log_in()
            body = bytearray(ua_binary.struct_to_binary(dice.choice(makers)(peer.token)))
            packets -= 1
            peer.send_body(mutated(body, dice))
            async with asyncio.timeout(0.01):
                if not await peer.reader.read(1_000_000):
                    peer = None
        except TimeoutError:
            continue
        except (OSError, ua.UaError, asyncio.IncompleteReadError, Exception):  # noqa: BLE001
            peer = None
            await asyncio.sleep(0.01)


def reading(node, count):
    request = ua.ReadRequest()
    request.Parameters.NodesToRead = [ua.ReadValueId(node, VALUE)] * count
    return request


async def subscribed(peer, interval=50.0):
    parameters = ua.CreateSubscriptionParameters(interval, 10_000, 1_000, 0, True, 0)  # noqa: FBT003
    request = ua.CreateSubscriptionRequest(Parameters=parameters)
    return (await peer.call(request, ua.CreateSubscriptionResponse)).Parameters.SubscriptionId


async def drained(peer):
    """Flush the send buffer and drop received bytes."""
    await asyncio.wait_for(peer.writer.drain(), 1.0)
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(0.002):
            if not await peer.reader.read(1_000_000):
                raise ConnectionError


LOADS = (
    {
        load.__name__: load
        for load in (
            connections,
            garbage,
            sessions,
            logins,
            passwords,
            subscriptions,
            monitored_items,
            publish_requests,
            chunks,
            reads,
            large_requests,
            slow_readers,
            broken_packets,
        )
    }
    | WORST
    | WORST_OF_ALARMS
)
PEERS = {"connections": 4, "sessions": 4, "logins": 4, "passwords": 4, "garbage": 2}


async def attack(load, url, until):
    """Continue for the given time, whatever the server answers."""
    while time.monotonic() < until:
        with contextlib.suppress(Exception):
            await load(url, until)
            if load is broken_packets:
                return
        await asyncio.sleep(0.01)


async def main(name, url, seconds):
    until = time.monotonic() + seconds
    single = name == "broken_packets" or name in WORST | WORST_OF_ALARMS
    count = 1 if single else PEERS.get(name, 2)
    await asyncio.gather(*(attack(LOADS[name], url, until) for _ in range(count)))


if __name__ == "__main__":
    os.nice(19)  # as from another machine: its processor time is taken from no other
    asyncio.run(main(sys.argv[1], sys.argv[2], float(sys.argv[3])))
