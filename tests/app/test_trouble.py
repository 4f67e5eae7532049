"""Everything that goes wrong says so in one line; what can be waited out is waited out."""

import asyncio
import socket
from dataclasses import replace

import pytest
from asyncua import ua

from guarded_opcua import ConfigurationError, ServerError
from support.processes import free_port, rig_url, run, service_url
from support.served import patient
from valvemap.app.build import build_identification
from valvemap.app.serve import serve
from valvemap.cli import run as run_here
from valvemap.config.valves import NodesConfig
from valvemap.errors import SourceLost, SourceRejected, StorageError


def one_line(answer, code):
    assert answer.returncode == code, answer.stderr
    *log, line = answer.stderr.strip().splitlines()
    assert line.startswith("valvemap: ")
    assert all("[info " in event for event in log), log
    return line


@pytest.fixture
def prepared(tmp_path):
    """A folder made by ``init``, and its configuration with free ports."""
    data = tmp_path / "data"
    assert run_here(["init", "--data", str(data)]) == 0
    text = (data / "service.toml").read_text(encoding="utf-8")
    text = text.replace(":4840", f":{free_port()}").replace(":4841", f":{free_port()}")
    text = text.replace("publishing_interval_ms", "startup_timeout_s = 0.5\npublishing_interval_ms")
    (data / "service.toml").write_text(text, encoding="utf-8")
    return data


@pytest.mark.waits
def test_a_source_that_is_not_there_is_named(prepared):
    line = one_line(run("serve", "--config", str(prepared / "service.toml")), 1)
    assert "opc.tcp://127.0.0.1" in line
    assert "/valvemap/rig/" in line


def test_a_port_in_use_is_named(prepared):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        url = service_url(taken.getsockname()[1])
        answer = run(
            "serve", "--config", str(prepared / "service.toml"), env={"VALVEMAP_SERVER__URL": url}
        )
    assert url in one_line(answer, 1)


def test_a_rig_whose_port_is_in_use_names_it(prepared):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        url = rig_url(taken.getsockname()[1])
        assert url in one_line(run("rig", "--data", str(prepared), "--url", url), 1)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["serve", "--config", "none.toml"], "none.toml"),
        (["replay", "none.csv"], "none.csv"),
        (["rig", "--scenario", "none"], "none"),
        (["rig", "--data", "nowhere"], "nowhere"),
        (["demo", "--duration", "soon"], "--duration"),
        (["trust", "nobody"], "nobody"),
    ],
)
def test_a_mistaken_argument_is_one_line(arguments, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run_here(arguments) in (1, 2)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("valvemap: ")
    assert said in line


async def attempt(config, open_server, error, match):
    with pytest.raises(error, match=match):
        async with asyncio.timeout(60):
            await serve(config, asyncio.Event(), open_server)


def port_of(url):
    return int(url.split(":")[2].split("/")[0])


def with_nodes(config, **nodes):
    (valve,) = config.valves
    of_rig = NodesConfig.of_rig("Valvistor").model_dump()
    valve = valve.model_copy(update={"nodes": NodesConfig(**{**of_rig, **nodes})})
    return config.model_copy(update={"valves": (valve,)})


async def test_a_missing_node_a_wrong_type_and_a_wrong_namespace_are_named(
    config, open_server, start_rig
):
    with start_rig(port_of(config.source.url)):
        missing = with_nodes(config, Q="nsu=urn:valvemap:rig;s=Valvistor.Flow")
        await attempt(missing, open_server, SourceRejected, r"Valvistor\.Flow.*Valvistor")
        wrong = with_nodes(config, Q="nsu=urn:valvemap:rig;s=Rig.Scenario")
        await attempt(wrong, open_server, SourceRejected, r"Rig\.Scenario.*String")
        nowhere = with_nodes(config, Q="nsu=urn:nobody;s=Q")
        await attempt(nowhere, open_server, SourceRejected, "urn:nobody")


async def test_a_state_file_that_cannot_be_written_is_named(config, open_server, tmp_path):
    (tmp_path / "file").write_text("")
    state = config.state.model_copy(update={"file": tmp_path / "file" / "state.sqlite"})
    bad = config.model_copy(update={"state": state})
    await attempt(bad, open_server, StorageError, r"state\.sqlite")


async def test_an_address_that_is_not_ours_is_named(config, open_server):
    other = replace(open_server, url="opc.tcp://192.0.2.1:4841/valvemap/service/")
    with pytest.raises((ServerError, ConfigurationError), match=r"192\.0\.2\.1"):
        await serve(config, asyncio.Event(), other)


async def test_a_source_without_answer_is_lost_not_rejected(config, open_server):
    source = config.source.model_copy(update={"startup_timeout_s": 0.2})
    gone = config.model_copy(update={"source": source})
    await attempt(gone, open_server, SourceLost, str(port_of(config.source.url)))


async def read(url, name):
    async with patient(url) as client:
        index = await client.get_namespace_index("urn:valvemap:service")
        node = client.get_node(ua.NodeId(name, index))
        return await node.read_data_value(raise_on_bad_status=False)


async def until(url, name, wanted):
    async with asyncio.timeout(60):
        while True:
            data = await read(url, name)
            if wanted(data.StatusCode):
                return data
            await asyncio.sleep(0.1)


async def test_a_source_that_vanishes_turns_results_bad_and_comes_back(
    config, open_server, start_rig
):
    port, stop = port_of(config.source.url), asyncio.Event()
    identification = build_identification(config)
    serving = None
    flow = "Valvistor.RLS.PredictedFlow"
    try:
        with start_rig(port, "--scenario", "demo"):
            serving = asyncio.ensure_future(serve(config, stop, open_server, identification))
            good = await until_serving(config.server.url, flow, serving)
        bad = await until(config.server.url, flow, lambda code: code.is_bad())
        assert bad.SourceTimestamp >= good.SourceTimestamp
        with start_rig(port, "--scenario", "demo"):
            again = await until(config.server.url, flow, lambda code: code.is_good())
            assert again.SourceTimestamp > bad.SourceTimestamp
    finally:
        stop.set()
        await serving


async def until_serving(url, name, serving):
    async with asyncio.timeout(60):
        while not serving.done():
            try:
                return await until(url, name, lambda code: code.is_good())
            except OSError:
                await asyncio.sleep(0.1)
    return serving.result()
