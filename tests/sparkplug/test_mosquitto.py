"""Mosquitto between a demo and a host of another make: births, data, kills, passwords, TLS."""

import asyncio
import re
from contextlib import contextmanager
from itertools import pairwise, repeat

import httpx
import pytest
from cryptography.hazmat.primitives import serialization

from support import certificates, services
from support.exposition import value
from support.mosquitto import GROUP, HOST, NODE, host, mosquitto, until, users
from support.processes import running, wait_for
from support.served import patient
from support.sparkplug_fakes import FakeService, Read
from valvemap.clock import SystemClock
from valvemap.errors import SinkError, SinkLost, SinkRejected
from valvemap.opcua_results.namespaces import SERVICE_NAMESPACE
from valvemap.sparkplug.broker import PahoBroker
from valvemap.sparkplug.edge_node import EdgeNode, Message
from valvemap.sparkplug.host import PrimaryHost
from valvemap.sparkplug.outbox import Outbox
from valvemap.sparkplug.reader import Reader
from valvemap.sparkplug.sender import Sender
from valvemap.sparkplug.settings import BrokerSettings
from valvemap.sparkplug.shown import Shown

PEM = serialization.Encoding.PEM

pytestmark = [pytest.mark.mosquitto, pytest.mark.timeout(600)]  # npm installs


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    with services.demo(tmp_path_factory.mktemp("demo")) as service:
        yield service


@contextmanager
def sending(folder, demo, broker, **more):
    env = {"BROKER": broker.url, "GROUP": GROUP, "EDGE_NODE": NODE, "PRIMARY_HOST": HOST, **more}
    names = {"METRICS": "VALVEMAP_METRICS"}
    env = {names.get(name, f"VALVEMAP_MQTT__{name}"): value for name, value in env.items()}
    log = folder / "mqtt.log"
    with running("mqtt", "--security", "None", "--url", demo.url, env=env, log=log) as process:
        wait_for(log, "results are sent", process)
        yield log
    assert process.returncode == 0


def births(heard, device="Valvistor"):
    return [m for m in heard if m["verb"] == "DBIRTH" and m["device"] == device]


def values(heard, name, verbs=("DDATA",)):
    """All that was said of a metric, in the order of its times."""
    metrics = [m for one in heard if one["verb"] in verbs for m in one["metrics"]]
    return sorted((m for m in metrics if m["name"] == name), key=lambda metric: metric["t"])


def last(heard, name):
    return values(heard, name, ("NBIRTH", "NDATA"))[-1]["value"]


def bd_seq(message):
    return next(m["value"] for m in message["metrics"] if m["name"] == "bdSeq")


async def names_at(url):
    """Names of the numbers of an estimator, as OPC UA has them."""
    async with patient(url) as client:
        index = await client.get_namespace_index(SERVICE_NAMESPACE)
        node = client.get_node(f"ns={index};s=Valvistor.RLS.Parameters")
        return {
            f"RLS/Parameters/{(await one.read_browse_name()).Name}"
            for one in await node.get_children()
        }


def test_a_host_of_another_make_reads_births_and_data_and_may_ask_for_births(
    demo, tmp_path, request
):
    cache = request.config.cache.mkdir("sparkplug_peer")
    with mosquitto(tmp_path) as broker, host(tmp_path, cache, broker) as listening:
        with sending(tmp_path, demo, broker, METRICS="127.0.0.1:0") as log:
            metrics = re.search(r"http://\S+", wait_for(log, "metrics served"))[0]
            heard = listening.once(lambda heard: len(values(heard, "Signals/U")) >= 3)
            born = {metric["name"]: metric for metric in births(heard)[0]["metrics"]}
            assert asyncio.run(names_at(demo.url)) <= born.keys()
            assert born["Signals/U"]["type"] == "Double"
            assert born["RLS/Status"]["type"] == "Int32"
            assert born["Alarms/Changed/Active"]["value"] is False
            assert born["Alarms/Changed/Severity"]["value"] > 0
            pressure = values(heard, "Signals/p1")[-1]
            assert 0.0 < pressure["value"] < 400.0  # bar
            assert (pressure["quality"], pressure["isNull"]) == (192, False)
            assert len({m["alias"] for m in births(heard)[0]["metrics"]}) == len(born)
            shown = httpx.get(metrics).text
            assert value(shown, "valvemap_broker_up") == 1
            assert value(shown, "valvemap_mqtt_metrics") > len(born)
            listening.ask_for_births()
            heard = listening.once(lambda now: len(births(now)) > len(births(heard)))
            nodes = [m for m in heard if m["verb"] == "NBIRTH"]
            assert {bd_seq(m) for m in nodes} == {0}
        heard = listening.once(lambda heard: heard[-1]["verb"] == "NDEATH")
        assert bd_seq(heard[-1]) == 0
        numbered = [m for m in heard if m.get("seq") is not None]
        for before, after in pairwise(numbered):
            follows = 0 if after["verb"] == "NBIRTH" else (before["seq"] + 1) % 256
            assert after["seq"] == follows


def test_a_host_of_another_make_reads_instances_of_templates(demo, tmp_path, request):
    cache = request.config.cache.mkdir("sparkplug_peer")
    with (
        mosquitto(tmp_path) as broker,
        host(tmp_path, cache, broker) as listening,
        sending(tmp_path, demo, broker, STRUCTURE="templates"),
    ):
        heard = listening.once(
            lambda heard: (
                len(values(heard, "Valve/Signals/U")) >= 3
                and any(p1["quality"] == 192 for p1 in values(heard, "Valve/Signals/p1"))
            )
        )
        nodes = [metric for m in heard if m["verb"] == "NBIRTH" for metric in m["metrics"]]
        (ref,) = {metric["template"] for metric in births(heard)[0]["metrics"]}
        assert ref in {metric["name"] for metric in nodes if metric["type"] == "Template"}
        good = [p1 for p1 in values(heard, "Valve/Signals/p1") if p1["quality"] == 192]
        assert 0.0 < good[-1]["value"] < 400.0  # bar
        assert not good[-1]["isNull"]


async def test_over_a_kill_of_the_broker_every_value_reaches_the_host(tmp_path, request):
    """Numbered values, some while it is away: none is missed, and bdSeq says that it was away."""
    cache = request.config.cache.mkdir("sparkplug_peer")
    flow, clock, outbox = "V1.Signals.Q", SystemClock(), Outbox(1_000)
    service = FakeService({flow: ("Double", Read(-1.0))})
    shown, pauses = Shown(outbox, clock.now()), lambda: repeat(0.2)
    with mosquitto(tmp_path) as broker, host(tmp_path, cache, broker) as listening:
        node, at = EdgeNode(GROUP, NODE), PahoBroker(settings(broker))
        reader = Reader(service, shown, ["*"], 0.1, clock, pauses)
        sender = Sender(at, node, shown, outbox, 0.1, clock, pauses, PrimaryHost(HOST))
        tasks = [asyncio.create_task(one.run()) for one in (reader, sender)]

        async def once(condition):
            await asyncio.to_thread(until, condition)

        async def send(numbers):
            before = outbox.newest
            service.sent += [(flow, Read(float(k))) for k in numbers]
            await once(lambda: outbox.newest >= before + len(numbers))

        def heard():
            return {m["value"]: m["isHistorical"] for m in values(listening.heard(), "Signals/Q")}

        await once(lambda: births(listening.heard(), "V1"))
        await send(range(50))
        broker.kill()
        await send(range(50, 150))
        broker.start()
        await once(lambda: 149.0 in heard())
        await send(range(150, 200))
        await once(lambda: 199.0 in heard())
        assert set(heard()) == {float(k) for k in range(200)}
        assert heard()[100.0] is True
        assert heard()[199.0] is False
        nodes = [m for m in listening.heard() if m["verb"] == "NBIRTH"]
        assert bd_seq(nodes[-1]) > bd_seq(nodes[0]) == 0
        assert outbox.lost == 0
        for task in reversed(tasks):
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)


def test_what_finds_no_room_while_the_broker_is_away_is_counted(demo, tmp_path, request):
    cache = request.config.cache.mkdir("sparkplug_peer")
    few = {"MOST_WAITING": "1000", "INTERVAL_S": "0.1"}
    with (
        mosquitto(tmp_path) as broker,
        host(tmp_path, cache, broker) as listening,
        sending(tmp_path, demo, broker, **few) as log,
    ):
        listening.once(lambda heard: len(values(heard, "Signals/U")) >= 3)
        broker.kill()
        wait_for(log, "nothing can be sent")
        wait_for(log, "values found no room")
        broker.start()
        listening.once(lambda heard: last(heard, "MQTT/Lost") > 0)


def settings(broker, **more):
    return BrokerSettings("127.0.0.1", broker.port, "valvemap-test", timeout_s=5.0, **more)


async def talk(broker_settings):
    """Say something and have it confirmed, over one connection."""
    node = EdgeNode("G", "N")
    session = await PahoBroker(broker_settings).connect(node.will(0), [node.commands])
    try:
        for message in node.births({None: ()}, {}, 0):
            session.publish(message)
        session.publish(Message(node.commands, b"hello"))
        await session.confirm()
        async with asyncio.timeout(10.0):
            while not (heard := session.received()):  # noqa: ASYNC110 - polled
                await asyncio.sleep(0.01)
        assert [message.payload for message in heard] == [b"hello"]
    finally:
        await session.close()


async def test_who_may_not_log_in_is_refused_and_no_password_is_said(tmp_path):
    with mosquitto(tmp_path, users(tmp_path, valvemap="a secret")) as broker:
        await talk(settings(broker, user="valvemap", password="a secret"))
        wrong = settings(broker, user="valvemap", password="another secret")
        with pytest.raises(SinkRejected, match="Not authorized") as refused:
            await talk(wrong)
        assert "secret" not in f"{refused.value}{wrong!r}"


async def test_nobody_there_is_a_loss(tmp_path):
    with mosquitto(tmp_path) as broker:
        pass
    with pytest.raises(SinkLost, match="connection refused"):
        await talk(settings(broker))


def kept(identity, folder, name):
    """A certificate and its key as PEM files."""
    file, key_file = folder / f"{name}.pem", folder / f"{name}.key"
    file.write_bytes(identity.certificate.public_bytes(PEM))
    traditional, plain = serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    key_file.write_bytes(identity.key.private_bytes(PEM, traditional, plain))
    return file, key_file


async def test_certificates_of_both_sides_are_checked(tmp_path):
    authority, other = certificates.root("authority"), certificates.root("other", number=4)
    ca_file, _ = kept(authority, tmp_path, "authority")
    own, own_key = kept(authority.issue("broker", number=1), tmp_path, "broker")
    ours, our_key = kept(authority.issue("valvemap", number=5), tmp_path, "ours")
    stranger, _ = kept(other, tmp_path, "other")
    more = f"cafile {ca_file}\ncertfile {own}\nkeyfile {own_key}\nrequire_certificate true"
    with mosquitto(tmp_path, f"{more}\nallow_anonymous true") as broker:
        shown = {"tls": True, "certificate_file": ours, "key_file": our_key}
        await talk(settings(broker, ca_file=ca_file, **shown))
        with pytest.raises(SinkRejected, match="certificate verify failed"):
            await talk(settings(broker, ca_file=stranger, **shown))
        with pytest.raises(SinkError):
            await talk(settings(broker, ca_file=ca_file, tls=True))


async def test_a_broker_of_another_name_is_not_trusted(tmp_path):
    authority = certificates.root("authority")
    ca_file, _ = kept(authority, tmp_path, "authority")
    own, own_key = kept(authority.issue("broker", hosts=("elsewhere",)), tmp_path, "broker")
    more = f"certfile {own}\nkeyfile {own_key}\nallow_anonymous true"
    with (
        mosquitto(tmp_path, more) as broker,
        pytest.raises(SinkRejected, match="certificate verify failed"),
    ):
        await talk(settings(broker, ca_file=ca_file, tls=True))
