"""Each connection has a place, and a time for each step; who is logged in stays."""

import asyncio
import contextlib
import socket
import ssl

import pytest

from support.page_attacks import Visitor
from support.served_page import served
from support.shown_service import ShownService
from valvemap.clock import ManualClock, SystemClock
from valvemap.page.door import Door, Place, Step
from valvemap.page.settings import PageSettings

SELF = "127.0.0.1"


class FakeTransport:
    """A transport that notes what becomes of it."""

    def __init__(self):
        self.closing = self.aborted = False
        self.unsent = 0

    def is_closing(self):
        return self.closing

    def get_write_buffer_size(self):
        return self.unsent

    def abort(self):
        self.aborted = self.closing = True


class Hall:
    """A door with one connection."""

    def __init__(self, step, **settings):
        self.clock = ManualClock()
        self.door = Door(PageSettings(**settings), self.clock)
        ours, self.theirs = socket.socketpair()
        self.place = Place(ours, self.clock)
        self.place.transport = FakeTransport()
        self.place.go_to(step)
        assert self.door._places.admit(self.place, "10.0.0.1")
        ours.close()
        self.theirs.close()

    def after(self, seconds):
        """Whether the connection is ended after these seconds."""
        self.clock.advance(seconds)
        self.door.end_overstaying()
        return self.place.transport.aborted


@pytest.mark.parametrize(
    ("step", "seconds"),
    [(Step.SILENT, 15.0), (Step.WAITING, 15.0), (Step.ANSWERING, 60.0), (Step.CLOSING, 3.0)],
)
def test_every_step_has_its_time(step, seconds):
    hall = Hall(step)
    assert not hall.after(seconds)
    assert hall.after(0.1)
    assert hall.door.refusals["overstayed"] == 1


def test_a_viewer_may_look_for_ever_as_long_as_it_reads():
    hall = Hall(Step.VIEWING)
    assert not hall.after(1e6)
    hall.place.transport.unsent = 2 * 1024 * 1024
    assert hall.after(1.0)


def test_a_goodbye_that_is_not_read_takes_no_longer_than_any_other():
    hall = Hall(Step.VIEWING)
    hall.place.transport.closing = True
    assert not hall.after(1.0)
    assert hall.after(4.0)


async def get(url):
    return await Visitor(url, SELF).get("/livez")


@contextlib.asynccontextmanager
async def holding(url, number, said=b""):
    """Hold a number of connections that say this, and no more."""
    visitor = Visitor(url, SELF)
    held = []
    for _ in range(number):
        held.append(await visitor.connect())
        held[-1][1].write(said)
    try:
        yield held
    finally:
        for _, writer in held:
            writer.transport.abort()


@pytest.mark.parametrize("said", [b"", b"GET / HTTP/1.1\r\nX-Slow: "])
async def test_connections_of_the_same_address_that_ask_for_nothing_give_way(said):
    async with served(ShownService()) as (page, url), holding(url, 260, said):
        for _ in range(14):
            assert await get(url) == 200
        assert len(page.door) <= page.settings.connections_of_address


async def test_silent_viewers_of_the_same_address_give_way_to_one_that_asks():
    async with served(ShownService(), viewers_of_address=5) as (page, url):
        async with contextlib.AsyncExitStack() as stack:
            for _ in range(5):
                await stack.enter_async_context(Visitor(url, SELF).socket())
            await Visitor(url, SELF).see()
        assert page.viewers.refused == 1


async def test_the_newest_viewer_of_the_address_that_has_most_gives_way():
    async with served(ShownService(), viewers=3, viewers_of_address=3) as (page, url):
        greedy = [Visitor(url, "127.0.0.2") for _ in range(3)]
        async with contextlib.AsyncExitStack() as stack:
            sockets = [await stack.enter_async_context(one.socket()) for one in greedy]
            for one in sockets:
                await one.send('{"watch": {"valve": "V1", "estimator": null, "overview": true}}')
                while not isinstance(await one.recv(), bytes):
                    pass
            await Visitor(url, "127.0.0.3").see()
            async with asyncio.timeout(5):
                await sockets[2].wait_closed()
            assert sockets[2].close_code == 1013
            assert sockets[0].close_code is None
        assert page.viewers.refused == 1


async def test_the_connection_of_who_is_logged_in_stays():
    async with (
        served(ShownService(), connections=3, connections_of_address=3) as (page, url),
        Visitor(url, "127.0.0.9").browser() as operator,
    ):
        body = {"user": "operator", "password": "right"}
        await operator.post("/log-in", json=body, headers={"Origin": url})
        assert (await operator.get("/user")).json()["user"] == "operator"
        (place,) = page.door._places
        async with holding(url, 30):
            assert (await operator.get("/user")).json()["user"] == "operator"
            assert place in page.door._places


async def test_refused_connections_are_counted_where_prometheus_looks():
    async with (
        served(ShownService(), connections=2, connections_of_address=2) as (_, url),
        holding(url, 5),
        Visitor(url, SELF).browser() as browser,
    ):
        text = (await browser.get("/metrics")).text
    assert 'valvemap_page_refused_total{why="crowded"} 4.0' in text
    assert "valvemap_page_connections 2.0" in text


async def test_a_connection_of_another_kind_is_refused_and_its_place_free():
    """Plain HTTP, silence and an early end free their places."""
    door = Door(PageSettings(handshake_s=0.3), SystemClock())
    listening = socket.create_server(("127.0.0.1", 0))
    url = f"https://127.0.0.1:{listening.getsockname()[1]}"
    tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    opening = asyncio.create_task(door.open(listening, lambda _: asyncio.Protocol(), tls))
    try:
        async with holding(url, 3), holding(url, 3, b"GET / HTTP/1.1\r\n\r\n") as held:
            held[0][1].transport.abort()
            async with asyncio.timeout(5):
                while sum(door.refusals.values()) < 6:  # noqa: ASYNC110 - a counter has no event
                    await asyncio.sleep(0.01)
        assert len(door) == 0
        assert door.refusals["handshake"] == 6
    finally:
        opening.cancel()
        await asyncio.gather(opening, return_exceptions=True)
        listening.close()
