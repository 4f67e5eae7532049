"""Settings, the first lines of a start, the cache of the standard nodes, the log."""

import logging
import os
import pickle
import socket
import sys

import pytest
from asyncua import ua
from asyncua.server.address_space import AddressSpace, NodeManagementService

from guarded_opcua import HardenedServer, Limits, Pki, ServerSettings, Unit, add_object
from guarded_opcua import add_variable as add
from guarded_opcua.address_space import standard_nodes as module
from guarded_opcua.address_space.standard_nodes import load_standard_address_space
from guarded_opcua.errors import ConfigurationError, ServerError
from guarded_opcua.logs import Bounded
from support.served import patient


def settings(url="opc.tcp://127.0.0.1:0/x/", **changes):
    values = {
        "url": url,
        "application_uri": "urn:test:x",
        "application_name": "x",
        "namespace_uri": "urn:x",
        "none_on_loopback": True,
    }
    return ServerSettings(**{**values, **changes})


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"url": "http://127.0.0.1:4840/"}, "an endpoint like"),
        ({"url": "opc.tcp://127.0.0.1/"}, "an endpoint like"),
        ({"url": "opc.tcp://:4840/"}, "an endpoint like"),
        ({"url": "opc.tcp://127.0.0.1:99999/"}, "an endpoint like"),
        ({"url": "opc.tcp://0.0.0.0:4840/"}, "listens on 127.0.0.1 or ::1 only"),
        ({"url": "opc.tcp://localhost:4840/"}, "listens on 127.0.0.1 or ::1 only"),
        ({"none_on_loopback": False}, "needs a PKI folder"),
    ],
)
async def test_settings_that_contradict_each_other_are_told_in_one_line(changes, said):
    with pytest.raises(ConfigurationError, match=said) as caught:
        await HardenedServer.create(settings(**changes))
    assert "\n" not in str(caught.value)


async def test_a_port_in_use_is_told_with_the_endpoint_and_the_server_starts_later():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        url = f"opc.tcp://127.0.0.1:{other.getsockname()[1]}/x/"
        server = await HardenedServer.create(settings(url))
        with pytest.raises(ServerError, match=rf"{url}: cannot listen there: .*in use"):
            await server.start()
    await server.start()
    assert server.url == url
    folder = await add_object(server, None, "Late")
    with pytest.raises(ServerError, match=r"Late: cannot be added: BadNodeIdExists"):
        await add_object(server, None, "Late")
    with pytest.raises(ServerError, match="needs a value_range"):
        await add(server, folder, "Late.p", 1.0, unit=Unit.BAR)
    await server.stop()
    await server.stop()


async def test_answers_do_not_wait_to_be_sent_with_the_next_one():
    server = await HardenedServer.create(settings())
    await server.start()
    async with patient(server.url):
        (connection,) = server._listener._connections
        sock = connection.transport.get_extra_info("socket")
        assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
    await server.stop()


@pytest.mark.parametrize(("interval_ms", "allowed"), [(50.0, 500.0), (1.0, 4_000.0)])
def test_who_may_be_told_often_may_ask_as_often(interval_ms, allowed):
    limits = Limits(publishing_interval_ms=interval_ms)
    assert limits.allowed_requests_per_second == allowed


async def test_an_address_that_is_not_ours_is_told(monkeypatch):
    async def nothing(*_):
        pass

    monkeypatch.setattr("guarded_opcua.server.HardenedServer.namespace", nothing)
    server = HardenedServer(settings("opc.tcp://192.0.2.1:4840/x/", none_on_loopback=False))
    monkeypatch.setattr("guarded_opcua.server.server_certificate", _no_certificate)
    with pytest.raises(ServerError, match=r"192\.0\.2\.1:4840.*: cannot listen there"):
        await server.start()


def _no_certificate(_):
    import datetime as dt

    class Certificate:
        not_valid_after_utc = dt.datetime(9000, 1, 1, tzinfo=dt.UTC)

        def public_bytes(self, _):
            return b""

    return Certificate(), None


@pytest.fixture
def parsed(monkeypatch):
    """Count how often the standard nodes are parsed; one node stands for all."""
    count = []

    def fill(management):
        count.append(1)
        item = ua.AddNodesItem()
        item.RequestedNewNodeId = ua.NodeId(85)
        item.BrowseName = ua.QualifiedName("Objects")
        item.NodeClass = ua.NodeClass.Object
        item.NodeAttributes = ua.ObjectAttributes()
        list(management.try_add_nodes([item], check=False))

    monkeypatch.setattr(module.standard_address_space, "fill_address_space", fill)
    return count


async def loaded(folder):
    aspace = AddressSpace()
    await load_standard_address_space(aspace, NodeManagementService(aspace), folder)
    return aspace


async def test_standard_nodes_are_parsed_once(tmp_path, parsed):
    first = await loaded(tmp_path / "cache")
    second = await loaded(tmp_path / "cache")
    assert len(parsed) == 1
    assert list(first.keys()) == list(second.keys()) == [ua.NodeId(85)]


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX modes")
@pytest.mark.parametrize("mode", [0o620, 0o602])
async def test_a_cache_that_others_could_have_written_is_not_opened(tmp_path, parsed, mode):
    await loaded(tmp_path / "cache")
    (file,) = (tmp_path / "cache").iterdir()
    assert file.stat().st_mode & 0o777 == 0o600
    file.chmod(mode)
    await loaded(tmp_path / "cache")
    assert len(parsed) == 2
    (tmp_path / "cache").chmod(0o777)
    await loaded(tmp_path / "cache")
    assert len(parsed) == 3


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX owners")
async def test_a_cache_of_another_user_or_behind_a_link_is_not_opened(
    tmp_path, parsed, monkeypatch
):
    folder = tmp_path / "cache"
    await loaded(folder)
    (file,) = folder.iterdir()
    file.rename(tmp_path / "elsewhere")
    file.symlink_to(tmp_path / "elsewhere")
    await loaded(folder)
    assert len(parsed) == 2
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    await loaded(folder)
    assert len(parsed) == 3


@pytest.mark.parametrize("content", [b"", b"rubbish", pickle.dumps([1, 2])])
async def test_a_damaged_cache_is_made_anew(tmp_path, parsed, content):
    await loaded(tmp_path / "cache")
    (file,) = (tmp_path / "cache").iterdir()
    file.write_bytes(content)
    aspace = await loaded(tmp_path / "cache")
    assert len(parsed) == 2
    assert ua.NodeId(85) in aspace
    await loaded(tmp_path / "cache")
    assert len(parsed) == 2


async def test_a_cache_that_cannot_be_written_is_done_without(tmp_path, parsed):
    (tmp_path / "cache").write_text("a file where a folder should be")
    assert ua.NodeId(85) in await loaded(tmp_path / "cache")
    assert len(parsed) == 1


def test_a_log_line_that_repeats_is_cut_and_counted():
    now = [0.0]
    quiet = Bounded(lines=3)

    def passes(text, *arguments):
        record = logging.makeLogRecord({"msg": text, "args": arguments, "created": now[0]})
        return record.getMessage() if quiet.filter(record) else None

    assert [passes("refused %s", n) for n in range(5)] == [
        "refused 0",
        "refused 1",
        "refused 2",
        None,
        None,
    ]
    assert passes("another") == "another"
    now[0] = 11.0
    assert passes("refused %s", 9) == "refused 9 (and 2 more like it)"
    assert passes("refused %s", 10) == "refused 10"


def test_pki_folders_are_named_as_the_standard_does(tmp_path):
    pki = Pki(tmp_path)
    pki.make_folders()
    assert {folder.name for folder in tmp_path.iterdir()} == {
        "own",
        "trusted",
        "issuers",
        "rejected",
    }
