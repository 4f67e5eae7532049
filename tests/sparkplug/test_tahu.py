"""The host of Eclipse Tahu, Mosquitto and a service: templates, and who may command a valve."""

import asyncio
import json
import math
import re
import time
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path

import pytest
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion

from support import services
from support.mosquitto import GROUP, HOST, NODE, mosquitto, tahu_host, until, users
from support.processes import running, wait_for
from valvemap.opcua_client.results_client import ResultsClient
from valvemap.opcua_client.source_settings import Security, SourceSettings
from valvemap.opcua_results.namespaces import RIG_NAMESPACE, SERVICE_NAMESPACE
from valvemap.sparkplug.schema import Payload

pytestmark = [pytest.mark.mosquitto, pytest.mark.timeout(600)]  # Maven and npm install

DOCUMENT = Path(__file__).parents[2] / "docs" / "mqtt.md"
VALVE = "Valvistor"
PASSWORDS = {name: f"secret of {name}" for name in ("valvemap", "scada", "stranger")}
DEMAND, DROP = f"{VALVE}.Inverse.FlowDemand", f"{VALVE}.Inverse.PressureDrop"
ALARM = "Valve/Alarms/SensorLost"
ACTION, REQUIRED = f"{VALVE}.Diagnostics.LastAction", "Valve/Inverse/RequiredU"


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    with services.demo(tmp_path_factory.mktemp("demo")) as service:
        yield service


@pytest.fixture
def broker(tmp_path):
    """A broker with the access list of `docs/mqtt.md`, where ``stranger`` may only listen."""
    rights = re.search("```\n(user valvemap\n.*?)```", DOCUMENT.read_text(), re.DOTALL)[1]
    access = tmp_path / "access"
    access.write_text(f"{rights}user stranger\ntopic read spBv1.0/#\n")
    more = f"{users(tmp_path, **PASSWORDS)}\nacl_file {access}"
    with mosquitto(tmp_path, more) as listening:
        yield listening


@contextmanager
def sending(folder, demo, broker, *, operator=False, **more):
    """``valvemap mqtt`` with the rights of an observer, or of an operator."""
    secret = folder / "broker-password"
    secret.write_text(PASSWORDS["valvemap"])
    env = {"BROKER": broker.url, "GROUP": GROUP, "EDGE_NODE": NODE, "USER": "valvemap"}
    env |= {"PASSWORD_FILE": str(secret), "STRUCTURE": "templates", **more}
    env = {f"VALVEMAP_MQTT__{name}": value for name, value in env.items()}
    log, log_in = folder / "mqtt.log", []
    if operator:
        own = folder / "operator-password"
        own.write_text(demo.password)
        log_in = ["--user", "operator", "--password-file", str(own)]
    command = ["mqtt", "--security", "None", "--url", demo.url, *log_in]
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


async def values_of(demo, *ids):
    async with looking(demo) as client:
        return [reading.value for reading in await client.read(ids)]


async def units_of(demo, ids):
    async with looking(demo) as client:
        return {id_: of.unit for id_, of in zip(ids, await client.engineering(ids), strict=True)}


async def inject(demo, *fault):
    settings = SourceSettings(demo.rig, Security.NONE, user="operator", password=demo.password)
    rig = ResultsClient(settings, RIG_NAMESPACE)
    await rig.connect()
    try:
        await rig.call(VALVE, "InjectFault", [fault])
    finally:
        await rig.close()


def born(heard, device=VALVE):
    return [m for m in heard if m["verb"] == "DBIRTH" and m["device"] == device]


def data(heard, path):
    """All values of a path in data, in their order."""
    return [m["metrics"][path] for m in heard if m["verb"] == "DATA" and path in m["metrics"]]


def newest(heard, path):
    """The newest number of a path in data; NaN before the first."""
    numbers = [value for value in data(heard, path) if value is not None]
    return numbers[-1] if numbers else math.nan


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


def test_a_demand_and_an_acknowledgement_of_an_operator_have_their_effect(
    demo, broker, tmp_path, request
):
    allowed = {"COMMANDS": '["demand", "acknowledge"]', "PRIMARY_HOST": HOST}
    with (
        listening(tmp_path, request, broker) as host,
        sending(tmp_path, demo, broker, operator=True, **allowed),
    ):
        host.once(born)
        host.command(VALVE, "Valve/Inverse/PressureDrop", 100.0)
        host.command(VALVE, "Valve/Inverse/FlowDemand", 20.0)
        at = host.once(lambda heard: newest(heard, REQUIRED) > 0.0)
        assert data(at, "Valve/Inverse/FlowDemand") == [20.0]
        low = newest(at, REQUIRED)
        host.command(VALVE, "Valve/Inverse/FlowDemand", 60.0)
        host.once(lambda heard: newest(heard, REQUIRED) > 1.5 * low)
        assert asyncio.run(values_of(demo, DEMAND, DROP)) == [60.0, 100.0]
        assert asyncio.run(values_of(demo, ACTION))[0].startswith("operator")
        asyncio.run(inject(demo, "bad_quality.Q", 1.0, 5.0))
        host.once(lambda heard: data(heard, f"{ALARM}/Active")[-1:] == [True])
        text = host.once(lambda heard: data(heard, f"{ALARM}/Text"))
        assert "usable sample" in data(text, f"{ALARM}/Text")[-1]
        host.command(VALVE, f"{ALARM}/Acknowledge", "seen by the shift")
        heard = host.once(lambda heard: data(heard, f"{ALARM}/Acked")[-1:] == [True])
        # changes alone are data: without False it was unacknowledged before, since a slow start
        assert data(heard, f"{ALARM}/Acked") in ([False, True], [True])
        assert "seen by the shift" in asyncio.run(values_of(demo, ACTION))[0]
        done = host.once(lambda heard: data(heard, "MQTT/CommandsDone")[-1:] == [4])
        assert data(done, "MQTT/CommandsRefused") == []


class Publisher:
    """A client of the broker that publishes commands and hears the edge node's own metrics."""

    def __init__(self, broker, user):
        self.counts = {}
        self._names = {}
        self._client = Client(CallbackAPIVersion.VERSION2, client_id="publisher")
        self._client.username_pw_set(user, PASSWORDS[user])
        self._client.on_message = self._hear
        self._client.connect("127.0.0.1", broker.port)
        self._client.subscribe(f"spBv1.0/{GROUP}/+/{NODE}", qos=1)
        self._client.loop_start()

    def _hear(self, _client, _userdata, message):
        for metric in Payload.FromString(message.payload).metrics:
            self._names.setdefault(metric.alias, metric.name)
            name = metric.name or self._names[metric.alias]
            self.counts[name] = metric.string_value or metric.long_value

    def ask(self, name, value, alias=None):
        payload = Payload(timestamp=int(time.time() * 1e3))
        metric = payload.metrics.add(name=name)
        metric.double_value = value
        if alias is not None:
            metric.alias = alias
        topic = f"spBv1.0/{GROUP}/DCMD/{NODE}/{VALVE}"
        self._client.publish(topic, payload.SerializeToString(), qos=1).wait_for_publish(10.0)

    def settled(self, asked):
        """Wait until every command is counted; return the counts."""
        names = ("MQTT/CommandsDone", "MQTT/CommandsRefused", "MQTT/CommandsLost")
        until(lambda: sum(self.counts.get(name, 0) for name in names) == asked)
        return tuple(self.counts[name] for name in names)

    def close(self):
        self._client.disconnect()
        self._client.loop_stop()


@pytest.mark.parametrize(
    ("user", "allowed", "operator", "counted"),
    [
        ("scada", [], True, False),
        ("scada", ["demand"], False, True),
        ("scada", ["acknowledge"], True, True),
        ("stranger", ["demand"], True, False),
    ],
    ids=["no command is allowed", "role of an observer", "another command", "no right at broker"],
)
def test_a_thousand_commands_without_authority_change_nothing(
    demo, broker, tmp_path, user, allowed, operator, counted
):
    before = asyncio.run(values_of(demo, DEMAND, DROP, ACTION))
    publisher = Publisher(broker, user)
    try:
        with sending(tmp_path, demo, broker, operator=operator, COMMANDS=json.dumps(allowed)):
            until(lambda: "MQTT/CommandsRefused" in publisher.counts)
            for k in range(1_000):
                name = "FlowDemand" if k % 2 else "PressureDrop"
                publisher.ask(f"Valve/Inverse/{name}", 5.0 + k % 90)
            if counted:
                done, refused, lost = publisher.settled(1_000)
                assert (done, refused + lost) == (0, 1_000)
                assert refused > 0
                assert publisher.counts["MQTT/LastRefusal"]
            else:
                assert publisher.counts["MQTT/CommandsRefused"] == 0
            assert asyncio.run(values_of(demo, DEMAND, DROP, ACTION)) == before
    finally:
        publisher.close()
