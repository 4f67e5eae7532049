"""The service manager is notified of the start, the life and the end of the service."""

import asyncio
import os
import socket
import threading
from contextlib import contextmanager, suppress

import numpy as np
import pytest
from structlog.testing import capture_logs

from valvemap.app.pulse import CONNECTING_S, Pulse
from valvemap.app.serve import serve
from valvemap.app.service_manager import BEATS, ServiceManager, feed_watchdog
from valvemap.clock import ManualClock
from valvemap.errors import SourceLost
from valvemap.runtime.sources import Part, Sources, supervise_all
from valvemap.runtime.supervisor import SupervisorSettings

pytestmark = pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="there is no such manager")

PERIOD_S = 30.0


@contextmanager
def listening(address):
    """A manager's socket at an address as `NOTIFY_SOCKET` writes it."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as inbox:
        inbox.bind("\0" + address[1:] if address[0] == "@" else address)
        inbox.settimeout(0.0)
        yield inbox


def received(inbox):
    messages = []
    with suppress(BlockingIOError):
        while True:
            messages.append(inbox.recv(4096).decode().split("\n"))
    return messages


@pytest.fixture(params=["path", "abstract"])
def address(request, tmp_path):
    own = f"valvemap-test-{os.getpid()}-{request.param}"
    return str(tmp_path / "notify") if request.param == "path" else f"@{own}"


@pytest.fixture
def inbox(address):
    with listening(address) as inbox:
        yield inbox


@pytest.fixture
def manager(address, inbox):
    return ServiceManager.of({"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "30000000"})


class Consumer:
    """Counts calls; waits for ``gate`` in the next one if there is one."""

    def __init__(self):
        self.calls, self.gate = [], None

    async def connected(self, valves=None, *, restarted_at):
        await self._note("connected")

    async def take(self, changes, valves=None):
        await self._note("take")

    async def tick(self, valves=None):
        await self._note("tick")

    async def lost(self, reason, valves=None):
        await self._note("lost")

    async def _note(self, name):
        self.calls.append(name)
        if self.gate is not None:
            await self.gate.wait()


@pytest.fixture
def clock():
    return ManualClock()


@pytest.fixture
def consumer():
    return Consumer()


@pytest.fixture
def pulse(consumer, clock):
    return Pulse(consumer, clock)


# -- messages


def test_each_message_is_one_datagram_of_assignments(manager, inbox):
    manager.ready("2 valves at opc.tcp://127.0.0.1:4841/")
    manager.alive()
    manager.stopping()
    assert received(inbox) == [
        ["READY=1", "STATUS=2 valves at opc.tcp://127.0.0.1:4841/"],
        ["WATCHDOG=1"],
        ["STOPPING=1", "STATUS=keeping states"],
    ]


@pytest.mark.parametrize("status", ["a\nWATCHDOG=trigger", "a\0MAINPID=1", "a\r\nFDSTORE=1"])
def test_a_status_adds_no_further_assignment(manager, inbox, status):
    manager.ready(status)
    (lines,) = received(inbox)
    assert [line.partition("=")[0] for line in lines] == ["READY", "STATUS"]
    assert "\0" not in lines[1]


@pytest.mark.parametrize(
    "environment",
    [{}, {"NOTIFY_SOCKET": ""}, {"NOTIFY_SOCKET": "vsock:2:1"}, {"WATCHDOG_USEC": "9"}],
)
def test_without_a_manager_nothing_is_sent_and_nothing_fails(environment):
    manager = ServiceManager.of(environment)
    assert manager == ServiceManager()
    manager.ready("")
    manager.alive()


@pytest.mark.parametrize(
    ("more", "period_s"),
    [
        ({"WATCHDOG_USEC": "2500000"}, 2.5),
        ({"WATCHDOG_USEC": "2500000", "WATCHDOG_PID": "77"}, 2.5),
        ({"WATCHDOG_USEC": "2500000", "WATCHDOG_PID": "78"}, 0.0),
        ({"WATCHDOG_USEC": "soon"}, 0.0),
        ({"WATCHDOG_USEC": "-1"}, 0.0),
        ({"WATCHDOG_USEC": "²"}, 0.0),
        ({}, 0.0),
    ],
)
def test_the_watchdog_s_period_is_ours_alone(more, period_s):
    assert ServiceManager.of({"NOTIFY_SOCKET": "/run/x", **more}, 77).watchdog_s == period_s


def test_a_manager_that_is_gone_is_one_line_in_the_log(tmp_path):
    with capture_logs() as said:
        ServiceManager(str(tmp_path / "gone")).alive()
    assert [line["event"] for line in said] == ["service manager not notified"]


def test_a_manager_that_does_not_read_delays_nothing(tmp_path):
    address = str(tmp_path / "full")
    with listening(address), capture_logs() as said:
        for _ in range(10_000):
            ServiceManager(address).alive()
            if said:
                break
    assert said[0]["reason"] == os.strerror(11)


# -- the pulse


async def test_a_connected_source_must_beat_in_each_period(pulse, clock):
    await pulse.connected(restarted_at=None)
    clock.advance(PERIOD_S)
    assert pulse.overdue_s(clock.monotonic(), PERIOD_S) == 0.0
    clock.advance(0.5)
    assert pulse.overdue_s(clock.monotonic(), PERIOD_S) == 0.5
    await pulse.tick()
    assert pulse.overdue_s(clock.monotonic(), PERIOD_S) == -PERIOD_S


async def test_a_source_that_connects_may_be_silent_for_longer(pulse, clock):
    assert pulse.overdue_s(clock.monotonic(), PERIOD_S) == -PERIOD_S - CONNECTING_S
    await pulse.connected(restarted_at=None)
    await pulse.lost(SourceLost("cut"))
    clock.advance(PERIOD_S + CONNECTING_S)
    assert pulse.overdue_s(clock.monotonic(), PERIOD_S) == 0.0
    clock.advance(1.0)
    assert pulse.overdue_s(clock.monotonic(), PERIOD_S) == 1.0


@pytest.mark.parametrize("call", ["connected", "take", "tick", "lost"])
async def test_a_call_that_does_not_return_is_a_missing_beat(pulse, consumer, clock, call):
    consumer.gate = asyncio.Event()
    calls = {
        "connected": lambda: pulse.connected(restarted_at=None),
        "take": lambda: pulse.take(None),
        "tick": pulse.tick,
        "lost": lambda: pulse.lost(SourceLost("cut")),
    }
    hanging = asyncio.create_task(calls[call]())
    await asyncio.sleep(0)
    clock.advance(PERIOD_S + 1.0)
    assert pulse.overdue_s(clock.monotonic(), PERIOD_S) == 1.0
    consumer.gate.set()
    await hanging
    assert pulse.overdue_s(clock.monotonic(), PERIOD_S) <= -PERIOD_S
    assert consumer.calls == [call]


async def test_the_source_that_is_silent_counts_not_the_one_that_beats(pulse, clock):
    north, south = np.array([0, 2]), np.array([1])
    await pulse.connected(north, restarted_at=None)
    await pulse.connected(south, restarted_at=None)
    clock.advance(PERIOD_S + 1.0)
    await pulse.tick(north)
    assert pulse.overdue_s(clock.monotonic(), PERIOD_S) == 1.0
    await pulse.tick(south)
    assert pulse.overdue_s(clock.monotonic(), PERIOD_S) < 0.0


# -- the watchdog


class Turns:
    """Waits by turning the clock; ends the loop after a number of them."""

    def __init__(self, clock, turns):
        self._clock, self.left, self.waited = clock, turns, []

    async def __call__(self, seconds):
        self._clock.advance(seconds)
        self.waited.append(seconds)
        self.left -= 1
        if self.left == 0:
            raise asyncio.CancelledError


async def feed(manager, pulse, clock, turns):
    wait = Turns(clock, turns)
    with suppress(asyncio.CancelledError):
        await feed_watchdog(manager, pulse, clock, wait)
    return wait.waited


async def test_the_watchdog_is_fed_some_times_in_each_period(manager, inbox, pulse, clock):
    waited = await feed(manager, pulse, clock, 5)
    assert received(inbox) == [["WATCHDOG=1"]] * 5
    assert waited == [PERIOD_S / BEATS] * 5


async def test_a_silent_supervisor_is_not_fed_and_named_once(manager, inbox, pulse, clock):
    await pulse.connected(restarted_at=None)
    with capture_logs() as said:
        await feed(manager, pulse, clock, BEATS + 5)
    assert received(inbox) == [["WATCHDOG=1"]] * (BEATS + 1)
    assert [line["event"] for line in said] == ["supervisor silent, watchdog not fed"]
    await pulse.tick()
    await feed(manager, pulse, clock, 1)
    assert received(inbox) == [["WATCHDOG=1"]]


async def test_a_manager_that_does_not_watch_is_not_fed(address, inbox, pulse, clock):
    await feed_watchdog(ServiceManager(address), pulse, clock)
    assert received(inbox) == []


async def test_a_blocked_loop_feeds_nothing(address, inbox, pulse, clock):
    manager = ServiceManager(address, watchdog_s=0.03)
    feeding = asyncio.create_task(feed_watchdog(manager, pulse, clock))
    await asyncio.sleep(0)
    received(inbox)
    release = threading.Event()
    threading.Timer(0.2, release.set).start()
    release.wait()  # as a kernel would that does not return
    assert received(inbox) == []
    feeding.cancel()


class StuckSource:
    """Connects, then hangs while it is dropped."""

    is_held, mark, started, connects = False, None, 0, 0

    async def connect(self):
        self.connects += 1

    async def receive(self):
        raise SourceLost("cut")

    async def drop(self):
        await asyncio.Event().wait()

    async def close(self):
        pass


async def test_a_supervisor_that_hangs_between_two_calls_is_noticed(manager, inbox, pulse, clock):
    sources = Sources([Part(None, StuckSource(), (0,))])
    life = asyncio.create_task(
        supervise_all(sources, pulse, clock, asyncio.Event(), SupervisorSettings())
    )
    for _ in range(20):
        await asyncio.sleep(0)
    await feed(manager, pulse, clock, BEATS + 5)
    assert len(received(inbox)) == BEATS + 1
    life.cancel()
    with suppress(asyncio.CancelledError):
        await life


@pytest.mark.timeout(120)
async def test_a_service_is_ready_when_it_answers_and_says_when_it_ends(
    config, open_server, address, inbox
):
    """Its source is away: that is trouble of the plant, and the service is alive."""
    manager = ServiceManager(address, watchdog_s=0.1)
    stop, loop = asyncio.Event(), asyncio.get_running_loop()
    life = asyncio.create_task(serve(config, stop, open_server, manager=manager))
    first = await loop.sock_recv(inbox, 4096)
    assert first.decode().split("\n") == ["READY=1", f"STATUS=1 valves at {config.server.url}"]
    _, writer = await asyncio.open_connection(*config.server.url.split("/")[2].split(":"))
    writer.close()
    assert await loop.sock_recv(inbox, 4096) == b"WATCHDOG=1"
    stop.set()
    await life
    *before, last = received(inbox)
    assert last[0] == "STOPPING=1"
    assert before == [["WATCHDOG=1"]] * len(before)
