"""A program's metrics: served in a thread of its own, bounded, and refused to foreign hosts."""

import socket
import time

import httpx
import pytest

from support.exposition import names, parsed, promtool_accepts, value
from valvemap.app.exporter import Exporter
from valvemap.app.metrics_address import MetricsAddress
from valvemap.app.serving_metrics import metrics_served
from valvemap.errors import ConfigurationError
from valvemap.page.exposition import exposition
from valvemap.page.server import PageError
from valvemap.vocabulary.fleet_series import SPOOL_BYTES, WORKER_LAG, WORKER_REJECTED
from valvemap.vocabulary.program_series import PROGRAMS
from valvemap.vocabulary.series import Point, Series

LOOPBACK = MetricsAddress("127.0.0.1", 0)


def two_points():
    yield Point(SPOOL_BYTES, 12.0)
    yield Point(WORKER_LAG, 3.0, ("t", "0"))
    yield Point(WORKER_REJECTED, float("nan"))


def test_metrics_are_served_until_the_end_and_the_port_is_free_again():
    with Exporter(LOOPBACK, two_points) as exporter:
        answer = httpx.get(exporter.url)
        assert httpx.get(exporter.url.replace("/metrics", "/livez")).text == "alive\n"
        assert httpx.get(exporter.url.replace("/metrics", "/")).status_code == 404
    assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
    assert value(answer.text, "valvemap_spool_bytes") == 12.0
    assert value(answer.text, "valvemap_worker_lag_messages", topic="t", partition="0") == 3.0
    assert "valvemap_worker_rejected_messages_total" not in names(answer.text)
    assert "valvemap_build_info" in names(answer.text)
    promtool_accepts(answer.text)
    with pytest.raises(httpx.TransportError):
        httpx.get(exporter.url)


def test_only_loopback_and_configured_names_are_answered():
    with Exporter(MetricsAddress("127.0.0.1", 0, ("worker",)), two_points) as exporter:
        answers = [
            httpx.get(exporter.url, headers={"Host": host}).status_code
            for host in ("evil.example", "worker:9464", "localhost", "172.18.0.5:9464", "[fe80::1]")
        ]
        posted = httpx.post(exporter.url, content=b"x").status_code
        text = httpx.get(exporter.url).text
    assert answers == [421, 200, 200, 200, 200]
    assert posted in {403, 405}
    assert value(text, "valvemap_exporter_refused_total", why="host") == 1


def status_of(client, url):
    """The answer's code; None if the connection is refused."""
    try:
        return client.get(url).status_code
    except httpx.TransportError:
        return None


def test_a_flood_costs_one_computation_a_second_and_is_refused():
    computed = []

    def counted():
        computed.append(1)
        return two_points()

    with Exporter(LOOPBACK, counted) as exporter:
        began = time.monotonic()
        with httpx.Client() as client:
            codes = [status_of(client, exporter.url) for _ in range(100)]
        lasted = time.monotonic() - began
    assert len(computed) <= lasted + 2
    assert codes.count(200) <= 30 + 5 * lasted + 1
    assert set(codes) <= {200, 429, None}


def test_idle_connections_take_no_place_from_prometheus():
    with Exporter(LOOPBACK, two_points) as exporter:
        port = int(exporter.url.split(":")[2].split("/")[0])
        idle = [socket.create_connection(("127.0.0.1", port)) for _ in range(40)]
        try:
            assert httpx.get(exporter.url, timeout=10.0).status_code == 200
        finally:
            for one in idle:
                one.close()


def test_metrics_that_fail_stop_neither_the_exporter_nor_the_program():
    broken = [True]

    def points():
        if broken:
            broken.clear()
            raise RuntimeError("dictionary changed size during iteration")
        yield from two_points()

    with Exporter(LOOPBACK, points) as exporter:
        assert httpx.get(exporter.url).status_code == 503
        assert httpx.get(exporter.url).status_code == 200


def test_an_address_in_use_is_named_before_any_work():
    with Exporter(LOOPBACK, two_points) as exporter:
        port = int(exporter.url.split(":")[2].split("/")[0])
        with (
            pytest.raises(PageError, match=f"127.0.0.1:{port}"),
            metrics_served(MetricsAddress("127.0.0.1", port), two_points),
        ):
            raise AssertionError


def test_without_an_address_nothing_listens_and_nothing_is_imported():
    with metrics_served(None, lambda: pytest.fail("asked")):
        pass


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "valvemap.app.exporter", None)
    with (
        pytest.raises(ConfigurationError, match="valvemap\\[dashboard\\]"),
        metrics_served(LOOPBACK, list),
    ):
        raise AssertionError


@pytest.mark.parametrize("program", PROGRAMS)
def test_promtool_accepts_every_series_of_the_vocabulary(program):
    points = [Point(one, 1.0, tuple("x" for _ in one.labels)) for one in PROGRAMS[program]]
    text = exposition(points).decode()
    assert names(text) == {one.shown for one in PROGRAMS[program]}
    promtool_accepts(text)


def test_no_two_series_have_one_name():
    every = {one for of in PROGRAMS.values() for one in of}
    assert len({one.name for one in every}) == len(every)


@pytest.mark.parametrize("absurd", [float("inf"), -1e308, 1e308, 2.0**63])
def test_absurd_values_and_names_are_written_so_that_they_can_be_read(absurd):
    odd = Series("valvemap_odd", "Odd.", ("name",))
    text = exposition([Point(odd, absurd, ('a"b\\c\nd',))]).decode()
    assert r'name="a\"b\\c\nd"' in text
    assert list(parsed(text).values()) == [absurd]
    promtool_accepts(text)
