"""Plants of others, without an editor: `connect --yes`, then `serve`, then a map that is right.

Four valves: two that a server of asyncua shows in psi, gpm, mA and °F, their signals stamped one
after the other; two that node-opcua writes when they change, one pressure held still.
"""

import asyncio
import subprocess

import numpy as np
import pytest

from support import node_peer
from support.foreign import PLANT, Foreign
from support.processes import free_port, run, service_url
from valvemap.app.build import build_identification
from valvemap.app.models import open_model
from valvemap.app.serve import serve
from valvemap.config.loading import load_config

NOISE = 0.4  # l/min, one standard deviation of a flow meter
WITHIN_S = 180.0
POINTS = [(U, dp) for U in (20.0, 45.0, 70.0, 90.0) for dp in (60.0, 100.0, 140.0)]


def smooth(k, valve, t):
    """A plant that moves while it is read: each value is of its own stamp."""
    U = 50 + 30 * np.sin(0.9 * t) + 12 * np.sin(2.3 * t + valve)
    dp = 100 + 35 * np.sin(0.4 * t + 1) + 12 * np.sin(1.1 * t)
    noise = np.random.default_rng(2 * k + valve).normal(0, NOISE)
    return U, dp + 5, 5.0, GAINS["skewed"][valve] * U * dp**0.5 + noise


GAINS = {"skewed": (0.1, 0.07), "on change": (0.1, 0.08), "structure": (0.05,)}


@pytest.fixture
def skewed():
    server = Foreign(PLANT, ("Ventil 1", "Ventil 2"), smooth)
    server.start()
    assert server.ready.wait(60)
    yield server.url
    server.over.set()
    server.join(30)


@pytest.fixture
def on_change(request):
    yield from served_by(request, "plant.cjs")


@pytest.fixture
def structured(request):
    yield from served_by(request, "structures.cjs")


def served_by(request, name):
    """Serve a plant of node-opcua; yield its address."""
    node, script = node_peer.program(request.config.cache.mkdir("node_peer"), name)
    port = free_port()
    with subprocess.Popen(
        [node, script, str(port)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert "ready\n" in iter(process.stdout.readline, "")  # behind warnings of node-opcua's
        yield f"opc.tcp://127.0.0.1:{port}/plc/"
        process.stdin.close()
        process.wait(20)


def errors(identification, names, gains):
    """How far each valve's map is off at the points, l/min."""
    return [
        max(
            abs(identification.predict(name, "Auto", U, dp, 40.0)[0] - gain * U * dp**0.5)
            for U, dp in POINTS
        )
        for name, gain in zip(names, gains, strict=True)
    ]


async def learnt(url, names, gains, tmp_path, *, still=False, watch="5"):
    """Commission as a newcomer would; return what is said once every map is within 1 sigma."""
    out, data = tmp_path / "plant.toml", tmp_path / "data"
    asked = ("connect", url, "--out", str(out), "--data", str(data), "--watch", watch, "--yes")
    done = await asyncio.to_thread(run, *asked)
    assert done.returncode == 0, done.stdout + done.stderr
    config = load_config(out)
    server = config.server.model_copy(update={"url": service_url(free_port())})
    config = config.model_copy(update={"server": server})
    identification, stop = build_identification(config), asyncio.Event()
    serving = asyncio.create_task(serve(config, stop, None, identification))
    try:
        off, waiting = [np.inf], []
        for _ in range(int(WITHIN_S)):
            await asyncio.wait({serving}, timeout=1.0)
            assert not serving.done(), serving.exception()
            off = errors(identification, names, gains)
            waiting = [identification.results.waited_for(number) for number in range(len(names))]
            named = all(any(" still at " in one for one in said) for said in waiting)
            if max(off) <= NOISE and (named or not still):
                return [identification.timing(number) for number in range(len(names))], waiting
        raise AssertionError(f"{off} l/min off; {waiting}")
    finally:
        stop.set()
        await serving


@pytest.mark.node
async def test_signals_stamped_one_after_the_other_in_psi(skewed, tmp_path):
    timing, _ = await learnt(
        skewed, ("Ventil_1", "Ventil_2"), GAINS["skewed"], tmp_path, watch="10"
    )
    assert all("after the scan's first" in str(said) for said in timing)


@pytest.mark.node
async def test_tags_that_are_written_when_they_change(on_change, tmp_path):
    names, gains = ("Ventil1", "Ventil2"), GAINS["on change"]
    timing, waiting = await learnt(on_change, names, gains, tmp_path, still=True)
    for said in timing:
        assert any(one.startswith("p1 (") and one.endswith("held") for one in said)
    for said in waiting:
        assert any(one.startswith("p1 (nsu=urn:plc") and "still at 200 " in one for one in said)


@pytest.mark.node
async def test_members_of_a_structure_live_and_in_a_recording(structured, tmp_path):
    gains = GAINS["structure"]
    await learnt(structured, ("Valve",), gains, tmp_path, watch="12")
    config, recorded = tmp_path / "plant.toml", str(tmp_path / "recorded.csv")
    nodes = load_config(config).valves[0].nodes
    assert nodes.p2 == "member=Pressure[1].Value;nsu=urn:plc;s=Valve"
    for command in (
        ("record", recorded, "--config", str(config), "--duration", "15"),
        ("replay", recorded, "--config", str(config), "--save", str(tmp_path / "Valve.json")),
    ):
        done = await asyncio.to_thread(run, *command)
        assert done.returncode == 0, done.stdout + done.stderr
    model = open_model(tmp_path / "Valve.json")
    for U, dp in ((30.0, 120.0), (60.0, 140.0), (80.0, 160.0)):
        assert abs(model.predict([U], [dp])[0] - gains[0] * U * dp**0.5) < NOISE
