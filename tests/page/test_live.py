"""What a viewer gets: only what changed of what is in view, and word of every loss."""

import asyncio
import json
import struct
import time

import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from support.readings import Read
from support.served_page import served
from support.shown_service import ShownService
from valvemap.page.judgement import Reason, Severity

pytestmark = pytest.mark.waits

WATCH = {"watch": {"valve": "V1", "estimator": None, "overview": True}}


async def drain(socket, seconds):
    """Take all messages for so long, or until the socket closes; return their sizes."""
    sizes = []
    try:
        async with asyncio.timeout(seconds):
            while True:
                sizes.append(len(await socket.recv()))
    except TimeoutError:
        return sizes


async def gone(page):
    """Wait until nobody watches."""
    async with asyncio.timeout(10):
        while len(page.viewers):  # noqa: ASYNC110 - a set has no event
            await asyncio.sleep(0.01)


def viewer(url, origin=None):
    return connect(
        url.replace("http", "ws") + "/live", origin=origin or url, proxy=None, close_timeout=1
    )


class Seen:
    """Takes a viewer's messages apart."""

    def __init__(self, socket):
        self.socket = socket
        self.names, self.texts, self.rows, self.numbers = [], [], {}, {}
        self.matrices = {}

    async def until(self, condition):
        async with asyncio.timeout(20):
            while not condition(self):
                self.take(await self.socket.recv())

    def take(self, message):
        if isinstance(message, str):
            found = json.loads(message)
            self.texts.append(found)
            self.names += found.get("names", [])
        elif message[0] == 1:
            (n,) = struct.unpack_from("<I", message, 4)
            values = struct.unpack_from(f"<{n}d", message, 8)
            names = struct.unpack_from(f"<{n}H", message, 8 + 20 * n)
            self.numbers |= {self.names[k]: v for k, v in zip(names, values, strict=True)}
        elif message[0] == 2:
            _, name, _, rows, columns = struct.unpack_from("<HHHII", message, 2)
            values = struct.unpack_from(f"<{rows * columns}d", message, 24)
            self.matrices[self.names[name]] = (rows, columns, values)
        else:
            columns, n = message[1], struct.unpack_from("<I", message, 4)[0]
            numbers = struct.unpack_from(f"<{n * columns}d", message, 8)
            valves = struct.unpack_from(f"<{n}H", message, 8 + 8 * n * columns)
            for k, valve in enumerate(valves):
                self.rows[valve] = numbers[k * columns : (k + 1) * columns]

    def link(self):
        return next((text["link"] for text in reversed(self.texts) if "link" in text), None)


async def test_a_viewer_sees_numbers_move_and_names_once():
    async with served(ShownService()) as (_, url), viewer(url) as socket:
        await socket.send(json.dumps(WATCH))
        seen = Seen(socket)
        await seen.until(lambda s: {"RLS.PredictedFlow", "Signals.U"} <= s.numbers.keys())
        first = seen.numbers["RLS.SampleCount"]
        await seen.until(lambda s: s.numbers["RLS.SampleCount"] > first)
        assert (seen.numbers["RLS.PredictedFlow"], seen.numbers["Signals.U"]) == (10.0, 40.0)
        assert len(seen.names) == len(set(seen.names))
        assert seen.rows[0][0] == 0.0


async def test_what_does_not_change_is_not_sent_again():
    async with served(ShownService(moving=False)) as (_, url), viewer(url) as socket:
        await socket.send(json.dumps(WATCH))
        seen = Seen(socket)
        await seen.until(lambda s: "RLS.ParameterStd" in s.matrices)
        assert sum(await drain(socket, 1.0)) < 500  # a row or two of the overview


async def test_many_viewers_see_the_same_and_it_is_packed_once():
    async with served(ShownService()) as (page, url), viewer(url) as one, viewer(url) as two:
        packed = []
        packing = page.viewers._packing
        pack = packing._pack
        packing._pack = lambda *key: packed.append((key[0].revision, *key[1:])) or pack(*key)
        seen = Seen(one), Seen(two)
        for other in seen:
            await other.socket.send(json.dumps(WATCH))
        for _ in range(2):
            for other in seen:
                other.numbers.pop("RLS.SampleCount", None)
                await other.until(lambda s: "RLS.SampleCount" in s.numbers)
        assert seen[0].names == seen[1].names
        assert len(packed) == len(set(packed))


async def test_a_map_is_asked_of_the_service_only_while_somebody_looks_at_it():
    shown = ShownService()
    async with served(shown) as (page, url):
        async with viewer(url) as socket:
            await socket.send(json.dumps(WATCH))
            seen = Seen(socket)
            await seen.until(lambda s: "Signals.U" in s.numbers)
            assert not shown.calls
            watch = {"watch": {"valve": "V1", "estimator": "RLS", "overview": False}}
            await socket.send(json.dumps(watch))
            await seen.until(lambda s: {"RLS.SurfaceQ", "RLS.Coverage"} <= s.matrices.keys())
            assert seen.matrices["RLS.SurfaceQ"][:2] == (21, 17)
            assert seen.matrices["RLS.Coverage"][:2] == (2, 2)
        await gone(page)
        assert page.viewers.wanted(page.observer.places).live == set()


async def test_what_moves_is_followed_while_somebody_looks_and_only_of_the_valve_in_view():
    shown = ShownService(names=("V1", "V2"))
    async with served(shown) as (page, url):
        async with viewer(url) as socket, viewer(url) as second:
            for one in (socket, second):
                await one.send(json.dumps(WATCH))
                await Seen(one).until(lambda s: "Signals.U" in s.numbers)
            assert shown.followed == ("V1.Frame",)
            other = {"watch": {"valve": "V2", "estimator": None, "overview": False}}
            await socket.send(json.dumps(other))
            async with asyncio.timeout(10):
                while len(shown.followed) < 2:  # noqa: ASYNC110 - a service has no event
                    await asyncio.sleep(0.01)
            assert shown.followed == ("V1.Frame", "V2.Frame")
        await gone(page)
        async with asyncio.timeout(10):
            while shown.followed:  # noqa: ASYNC110
                await asyncio.sleep(0.01)


async def test_who_looks_from_afar_sees_a_value_each_second_and_nothing_is_followed():
    shown = ShownService()
    async with served(shown) as (_, url), viewer(url) as socket:
        afar = {"valve": "V1", "estimator": None, "overview": True, "fromAfar": True}
        await socket.send(json.dumps({"watch": afar}))
        seen = Seen(socket)
        await seen.until(lambda s: "RLS.SampleCount" in s.numbers and s.rows)
        began, reads, counts = time.monotonic(), shown.reads, set()
        while time.monotonic() < began + 4.0:
            seen.take(await socket.recv())
            counts.add(seen.numbers["RLS.SampleCount"])
        assert 3 <= len(counts) <= 6
        assert shown.followed == ()
        assert shown.reads - reads <= 6 * 8  # flow, frame; each five seconds what has changed
        await socket.send(json.dumps(WATCH))
        async with asyncio.timeout(10):
            while not shown.followed:  # noqa: ASYNC110 - a service has no event
                await asyncio.sleep(0.01)


async def test_a_service_without_room_for_who_follows_is_read_each_second():
    async with served(ShownService(may_follow=False)) as (_, url), viewer(url) as socket:
        await socket.send(json.dumps(WATCH))
        seen = Seen(socket)
        await seen.until(lambda s: "RLS.SampleCount" in s.numbers)
        first = seen.numbers["RLS.SampleCount"]
        await seen.until(lambda s: s.numbers["RLS.SampleCount"] > first)
        assert seen.link() == "up"


async def test_the_slider_s_answer_is_the_service_s_own_and_writes_nothing():
    shown = ShownService()
    async with served(shown) as (_, url), viewer(url) as socket:
        seen = Seen(socket)
        await seen.until(lambda s: s.link() == "up")
        await socket.send(json.dumps({"ask": 7, "invert": "V1", "Q": 60, "dp": 100}))
        await seen.until(lambda s: any("answer" in text for text in s.texts))
        answer = next(text for text in seen.texts if "answer" in text)
        assert (answer["answer"], answer["U"], answer["status"]) == (7, 30.0, 0)
    assert shown.writes == []


async def test_a_service_that_goes_is_said_and_one_that_comes_back_is_seen():
    shown = ShownService()
    async with served(shown) as (_, url), viewer(url) as socket:
        seen = Seen(socket)
        await seen.until(lambda s: s.link() == "up")
        shown.up = False
        await seen.until(lambda s: s.link() == "lost")
        shown.up = True
        await seen.until(lambda s: s.link() == "up")
        said = [event[5] for text in seen.texts for event in text.get("events", [])]
        assert "The service does not answer." in said


async def test_a_silent_valve_becomes_an_alarm():
    shown = ShownService(moving=False)
    async with served(shown) as (_, url), viewer(url) as socket:
        await socket.send(json.dumps(WATCH))
        seen = Seen(socket)
        await seen.until(lambda s: 0 in s.rows and s.rows[0][0] == 3.0)
        await seen.until(
            lambda s: any("No new sample" in e[5] for t in s.texts for e in t.get("events", []))
        )


async def test_a_failed_sensor_is_an_alarm_with_its_reason():
    shown = ShownService()
    shown.values["V1.RLS.PredictedFlow"] = Read(1.0, 0x808C0000)
    async with served(shown) as (_, url), viewer(url) as socket:
        await socket.send(json.dumps(WATCH))
        seen = Seen(socket)
        await seen.until(lambda s: 0 in s.rows)
        assert seen.rows[0][:2] == (Severity.ALARM, Reason.SENSOR_FAILURE)


@pytest.mark.parametrize(
    "garbage",
    [
        "",
        "{",
        "[]",
        "null",
        '{"watch": {"valve": 1, "estimator": null, "overview": true}}',
        '{"ask": 1, "invert": "V1", "Q": NaN, "dp": 1}',
        '{"ask": 1, "invert": "nobody", "Q": 1, "dp": 1}',
        "[" * 3_000,
        b"\x00\xff" * 100,
        "x" * 5_000,
    ],
)
async def test_garbage_ends_the_viewer_that_sends_it_and_no_other(garbage):
    async with served(ShownService()) as (page, url), viewer(url) as good:
        seen = Seen(good)
        async with viewer(url) as bad:
            await bad.send(garbage)
            with pytest.raises(ConnectionClosed):
                await drain(bad, 10.0)
        await good.send(json.dumps(WATCH))
        await seen.until(lambda s: "Signals.U" in s.numbers)
        assert len(page.viewers) == 1


async def test_a_page_of_elsewhere_gets_no_socket():
    async with served(ShownService()) as (page, url):
        with pytest.raises((InvalidStatus, ConnectionClosed)):
            async with viewer(url, origin="http://evil.example") as socket:
                await socket.recv()
        assert page.guard.refusals["origin"] == 1


async def test_too_many_viewers_are_turned_away_and_counted():
    async with served(ShownService(), viewers=2) as (page, url):
        async with viewer(url) as first, viewer(url) as second:
            for one in (first, second):
                await one.send(json.dumps(WATCH))
                await Seen(one).until(lambda s: "Signals.U" in s.numbers)
            with pytest.raises((InvalidStatus, ConnectionClosed)):
                async with viewer(url) as third:
                    await third.recv()
        assert page.viewers.refused == 1


async def test_a_viewer_that_floods_is_hung_up_on():
    async with served(ShownService()) as (page, url), viewer(url) as flood:
        sent = [flood.send(json.dumps(WATCH)) for _ in range(200)]
        await asyncio.gather(*sent, return_exceptions=True)
        with pytest.raises(ConnectionClosed):
            await drain(flood, 20.0)
        assert page.viewers.senseless == 1


async def test_a_connection_that_says_nothing_is_dropped_and_too_many_are_not_taken():
    async with served(ShownService(), connections=5) as (_, url):
        host, port = url.removeprefix("http://").split(":")
        silent = [await asyncio.open_connection(host, int(port)) for _ in range(8)]
        ended = 0
        for reader, _ in silent:
            try:
                async with asyncio.timeout(1.0):
                    ended += not await reader.read(1)
            except TimeoutError:
                pass
            except ConnectionError:
                ended += 1
        assert ended == 3
        for _, writer in silent:
            writer.close()
