"""The host of Eclipse Tahu, Mosquitto and a service: templates."""

import asyncio
from contextlib import asynccontextmanager, contextmanager

import pytest

from support import services
from support.mosquitto import GROUP, NODE, mosquitto, tahu_host, users
from support.processes import running, wait_for
from valvemap.opcua_client.results_client import ResultsClient, Security, SourceSettings
from valvemap.opcua_results.namespaces import SERVICE_NAMESPACE

pytestmark = [pytest.mark.mosquitto, pytest.mark.timeout(600)]  # Maven and npm install

VALVE = "Valvistor"
PASSWORDS = {name: f"secret of {name}" for name in ("valvemap", "scada")}


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    with services.demo(tmp_path_factory.mktemp("demo")) as service:
        yield service


@pytest.fixture
def broker(tmp_path):
    with mosquitto(tmp_path, users(tmp_path, **PASSWORDS)) as listening:
        yield listening


@contextmanager
def sending(folder, demo, broker):
    """``valvemap mqtt`` with templates."""
    secret = folder / "broker-password"
    secret.write_text(PASSWORDS["valvemap"])
    env = {"BROKER": broker.url, "GROUP": GROUP, "EDGE_NODE": NODE, "USER": "valvemap"}
    env |= {"PASSWORD_FILE": str(secret), "STRUCTURE": "templates"}
    env = {f"VALVEMAP_MQTT__{name}": value for name, value in env.items()}
    log = folder / "mqtt.log"
    command = ["mqtt", "--security", "None", "--url", demo.url]
    with running(*command, env=env, log=log) as process:
        wait_for(log, "results are sent", process)
        yield log
    assert process.returncode == 0


@contextmanager
def listening(tmp_path, request, broker):
    cache = request.config.cache.mkdir("tahu_host")
    with tahu_host(tmp_path, cache, broker, "scada", PASSWORDS["scada"]) as host:
        yield host


@asynccontextmanager
async def looking(demo):
    client = ResultsClient(SourceSettings(demo.url, Security.NONE), SERVICE_NAMESPACE)
    await client.connect()
    try:
        yield client
    finally:
        await client.close()


async def units_of(demo, ids):
    async with looking(demo) as client:
        return {id_: of.unit for id_, of in zip(ids, await client.engineering(ids), strict=True)}


def born(heard, device=VALVE):
    return [m for m in heard if m["verb"] == "DBIRTH" and m["device"] == device]


def data(heard, path):
    """All values of a path in data, in their order."""
    return [m["metrics"][path] for m in heard if m["verb"] == "DATA" and path in m["metrics"]]


def test_tahu_builds_the_template_of_a_valve_from_its_births_alone(demo, broker, tmp_path, request):
    with listening(tmp_path, request, broker) as host, sending(tmp_path, demo, broker):
        heard = host.once(lambda heard: len(data(heard, "Valve/Signals/U")) >= 3)
        (valve,) = born(heard)[0]["metrics"].values()
        nodes = [m for m in heard if m["verb"] == "NBIRTH"][-1]["metrics"]
        assert nodes[valve["template"]]["isDefinition"] is True
        assert (valve["isDefinition"], valve["undeclared"]) == (False, [])
        members = valve["members"]
        assert len(members) == nodes[valve["template"]]["members"] > 150
        ids = {name: f"{VALVE}.{name.replace('/', '.')}" for name in members}
        units = asyncio.run(units_of(demo, list(ids.values())))
        wanted = {name: units[id_] for name, id_ in ids.items() if units[id_]}
        assert {n: m["engUnit"] for n, m in members.items() if "engUnit" in m} == wanted
        assert len(wanted) > 50
        assert members["Alarms/Changed/Active"]["value"] is False
        assert members["Alarms/Changed/Severity"]["value"] > 0
        assert "Acknowledge" in members["Alarms/Changed/Meaning"]["value"]
        assert members["Signals/p1"]["engHigh"] > members["Signals/p1"]["engLow"]
        assert members["Signals/p1"]["documentation"].startswith("Pressure")
        assert not any("null" in m["metrics"] for m in heard if m["verb"] == "DATA")
        assert host.complaints() == []
