import asyncio
import re
from dataclasses import replace
from urllib.parse import urlsplit

import numpy as np
import pytest
import pytest_asyncio
from asyncua import Server, ua

from guarded_opcua import (
    CertificateError,
    HardenedServer,
    Limits,
    Pki,
    Role,
    ServerSettings,
    Unit,
    UserStore,
    add_object,
    add_variable,
    ensure_certificate,
)
from guarded_opcua.security.pki_folders import trust
from support.plant_server import plant_settings
from support.proxy import Proxy
from support.users import CHEAP
from valvemap.errors import ConfigurationError, SourceLost, SourceRejected
from valvemap.opcua_client.source_settings import Security, SourceSettings
from valvemap.opcua_client.transport import BoundedClient
from valvemap.opcua_source import subscription as subscriptions
from valvemap.opcua_source.client import OpcUaSource
from valvemap.opcua_source.node_ids import parse_node_id
from valvemap.opcua_source.source_nodes import ValveNodes
from valvemap.pipeline.data_changes import DataChanges
from valvemap.vocabulary.signals import Signal

pytestmark = pytest.mark.asyncio(loop_scope="module")

START = 1_800_000_000_000_000_000
STEP = 10_000_000
WAITING = ua.StatusCodes.BadWaitingForInitialData
NODES = ValveNodes(
    valve="V1",
    U="nsu=urn:plant;s=V1.U",
    p1="nsu=urn:plant;s=V1.p1",
    p2="nsu=urn:plant;s=V1.p2",
    Q="nsu=urn:plant;s=V1.Q",
    T="nsu=urn:plant;s=V1.T",
    sequence="nsu=urn:plant;s=V1.Sequence",
    required_U="nsu=urn:plant;s=V1.Command",
)


class Plant:
    """A server with one valve that publishes whatever a test wants."""

    def __init__(self, server, variables, password):
        self.server = server
        self.variables = variables
        self.password = password
        self.written = 0

    @property
    def url(self):
        return self.server.url

    @property
    def settings(self):
        return SourceSettings(
            self.url,
            user="operator",
            password=self.password,
            publishing_interval_ms=50.0,
            keep_alive_s=0.1,
            timeout_s=1.0,
        )

    def sample(self, value=1.0, code=0):
        """All signals of one sample, 10 ms after the one before."""
        t = START + self.written * STEP
        values = [value] * 5 + [self.written]
        self.server.write(
            (variable, v, code, t) for variable, v in zip(self.variables, values, strict=True)
        )
        self.written += 1


async def plant_on(settings, password=""):
    server = await HardenedServer.create(settings)
    valve = await add_object(server, None, "V1")
    await add_variable(server, valve, "V1.Text", "x", type=ua.VariantType.String)
    await add_variable(server, valve, "V1.Array", [1.0], dimensions=(0,))
    await add_variable(
        server,
        valve,
        "V1.Command",
        0.0,
        unit=Unit.PERCENT,
        value_range=(0.0, 100.0),
        writable_by=Role.OPERATOR,
    )
    await add_variable(
        server, valve, "V1.Beat", 0, type=ua.VariantType.UInt32, writable_by=Role.OPERATOR
    )
    kinds = {"Sequence": ua.VariantType.UInt32, "p2": ua.VariantType.Float}
    names = ("U", "p1", "p2", "Q", "T", "Sequence")
    variables = [
        await add_variable(
            server, valve, f"V1.{name}", None, type=kinds.get(name, ua.VariantType.Double)
        )
        for name in names
    ]
    return Plant(server, variables, password)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def served():
    users, password = UserStore.one_time("operator", Role.OPERATOR, CHEAP)
    plant = await plant_on(plant_settings(users=users), password)
    async with plant.server:
        yield plant


@pytest_asyncio.fixture(loop_scope="module")
async def plant(served):
    served.written = 0
    served.server.write((v, None, WAITING, START) for v in served.variables)
    return served


@pytest_asyncio.fixture(loop_scope="module")
async def source(plant):
    source = OpcUaSource(plant.settings, [NODES])
    await source.connect()
    yield source
    await source.close()


async def received(source, count, seconds=5.0):
    """Receive until at least ``count`` changes of V1.Sequence are there."""
    parts = []
    async with asyncio.timeout(seconds):
        while sum(int((part.item == Signal.SEQUENCE).sum()) for part in parts) < count:
            parts.append(await source.receive())
    return DataChanges.concatenate(parts)


async def test_what_comes_before_all_is_ready_is_held_and_handed_out_then(plant):
    ready = asyncio.Event()
    source = OpcUaSource(plant.settings, [NODES], ready=ready.wait)
    await source.connect()
    first = asyncio.create_task(received(source, 21))  # and that there is no value yet
    for _ in range(20):
        plant.sample()
        await asyncio.sleep(0.01)  # more than one publishing
    assert not first.done()
    ready.set()
    assert of(await first, Signal.SEQUENCE).value[-20:].tolist() == list(range(20))
    await source.close()


def of(changes, signal):
    return changes[changes.item == signal]


def anonymous(settings):
    return replace(settings, user=None, password=None)


def through(settings, proxy):
    return replace(settings, url=f"opc.tcp://127.0.0.1:{proxy.port}/plant/")


class Losing:
    """A session that lets chosen publish responses vanish on their way."""

    def __init__(self, session, lost, *, republish=True):
        self._session = session
        self._lost = lost
        self._republish = republish
        self.seen = 0

    def __getattr__(self, name):
        return getattr(self._session, name)

    async def request(self, request, *, timeout=None):  # noqa: ASYNC109 - the session's signature
        if isinstance(request, ua.RepublishRequest) and not self._republish:
            raise ua.uaerrors.BadMessageNotAvailable
        data = await self._session.request(request, timeout=timeout)
        if isinstance(request, ua.PublishRequest):
            response = subscriptions.decode_publish_response(data)
            if not response.message.keep_alive:
                self.seen += 1
                if self.seen in self._lost:
                    return await self.request(ua.PublishRequest(), timeout=timeout)
        return data


async def test_every_sample_of_a_constant_signal_arrives_with_its_exact_time(plant, source):
    await received(source, 1)
    for _ in range(100):
        plant.sample()
        await asyncio.sleep(0.001)
    changes = await received(source, 100)
    for signal in Signal:
        got = of(changes, signal)
        assert got.source_time.tolist() == [START + k * STEP for k in range(100)]
        assert (got.status == 0).all()
    assert of(changes, Signal.SEQUENCE).value.tolist() == list(range(100))
    assert set(of(changes, Signal.P2).value) == {1.0}
    counters = source.counters
    assert counters.notifications == 606
    assert counters.missing_messages == counters.overflows == counters.undecodable == 0


async def test_a_bad_status_arrives_as_sent(plant, source):
    await received(source, 1)
    plant.sample(code=ua.StatusCodes.BadSensorFailure)
    changes = await received(source, 1)
    assert set(changes.status.tolist()) == {ua.StatusCodes.BadSensorFailure}
    assert np.isnan(changes.value).all()
    assert source.counters.undecodable == 0


async def test_before_the_first_sample_a_node_is_known_but_bad(source):
    changes = await received(source, 1)
    assert set(changes.status.tolist()) == {WAITING}


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"Q": "ns=2;s=V1.X"}, ["node 'ns=2;s=V1.X' (Q of valve V1)", "does not exist at opc.tcp"]),
        ({"T": "nsu=urn:plant;s=V1.Text"}, ["T of valve V1", "type String", "Double is needed"]),
        ({"p1": "nsu=urn:plant;s=V1.Array"}, ["p1 of valve V1", "array", "scalar is needed"]),
        ({"U": "nsu=urn:plant;s=V1"}, ["U of valve V1", "class Object", "Variable is needed"]),
        ({"U": "nsu=urn:other;s=V1.U"}, ["no namespace urn:other", "it has", "urn:plant"]),
        ({"required_U": "nsu=urn:plant;s=V1.U"}, ["required_U of valve V1", "cannot be written"]),
        ({"p1": "i=1", "p2": "i=2", "Q": "i=3"}, ["p1 of valve V1", "and 2 more nodes"]),
    ],
)
async def test_a_wrong_node_is_named_with_what_is_allowed(plant, wrong, words):
    source = OpcUaSource(plant.settings, [replace(NODES, **wrong)])
    with pytest.raises(SourceRejected) as error:
        await source.connect()
    assert all(word in str(error.value) for word in words)
    assert "\n" not in str(error.value)


async def test_who_may_not_write_is_told_before_anything_starts(plant):
    with pytest.raises(SourceRejected, match="cannot be written by this user"):
        await OpcUaSource(anonymous(plant.settings), [NODES]).connect()


async def test_required_U_is_written_to_its_node(plant, source):
    await source.write_required_U(0, 42.5)
    node = plant.server.ua.get_node(ua.NodeId("V1.Command", plant.server.namespace_index))
    assert await node.read_value() == 42.5


async def test_a_heartbeat_is_written_to_its_node(plant, source):
    with pytest.raises(SourceRejected, match="V1 has no node heartbeat"):
        await source.write_heartbeat(0, 1)
    nodes = replace(NODES, heartbeat="nsu=urn:plant;s=V1.Beat")
    other = OpcUaSource(plant.settings, [nodes])
    await other.connect()
    await other.write_heartbeat(0, 2**32 - 1)
    await other.close()
    node = plant.server.ua.get_node(ua.NodeId("V1.Beat", plant.server.namespace_index))
    assert await node.read_value() == 2**32 - 1


async def test_a_heartbeat_that_is_no_UInt32_is_named(plant):
    nodes = replace(NODES, heartbeat=NODES.required_U)
    with pytest.raises(SourceRejected, match=r"heartbeat of valve V1.*Double.*a UInt32 is needed"):
        await OpcUaSource(plant.settings, [nodes]).connect()


async def test_a_refused_value_is_named(source):
    with pytest.raises(SourceRejected, match=r"required_U of valve V1.*250.*BadOutOfRange"):
        await source.write_required_U(0, 250.0)


async def test_of_commands_in_one_request_each_is_taken_or_refused_by_itself(plant):
    nodes = replace(NODES, heartbeat="nsu=urn:plant;s=V1.Beat")
    source = OpcUaSource(plant.settings, [nodes])
    await source.connect()
    refused = await source.write_commands(0, {"required_U": 250.0, "load": 90.0, "heartbeat": 5})
    await source.close()
    assert "BadOutOfRange" in refused.pop("required_U")
    assert refused == {"load": "valve V1 has no node load"}
    node = plant.server.ua.get_node(ua.NodeId("V1.Beat", plant.server.namespace_index))
    assert await node.read_value() == 5


async def test_a_request_whose_response_meets_its_timeout_has_timed_out(monkeypatch):
    class WithResult(asyncio.CancelledError):
        """As asyncua's wait_for raises it before Python 3.12."""

    async def answered_too_late(*_):
        try:
            await asyncio.sleep(60.0)
        except asyncio.CancelledError:
            raise WithResult from None

    client = BoundedClient()
    monkeypatch.setattr(client, "_send_request", answered_too_late)
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.01):
            await client.call(None)


async def test_a_valve_without_the_node_cannot_be_written_to(plant):
    source = OpcUaSource(plant.settings, [replace(NODES, required_U=None)])
    with pytest.raises(SourceLost, match="not connected"):
        await source.write_required_U(0, 1.0)
    await source.connect()
    with pytest.raises(SourceRejected, match="V1 has no node required_U"):
        await source.write_required_U(0, 1.0)
    await source.close()


async def test_a_wrong_password_is_refused_and_never_shown(plant):
    settings = replace(plant.settings, password="hunter2hunter2")
    with pytest.raises(SourceRejected, match="user or password") as error:
        await OpcUaSource(settings, [NODES]).connect()
    assert "hunter2" not in str(error.value) + repr(settings)


async def test_nobody_listening_is_a_loss_that_names_the_address(unused_port):
    url = f"opc.tcp://127.0.0.1:{unused_port}/"
    with pytest.raises(SourceLost, match=re.escape(url)):
        await OpcUaSource(SourceSettings(url, timeout_s=1.0), [NODES]).connect()


@pytest.mark.parametrize("answer", [b"", b"HTTP/1.1 400 Bad Request\r\n\r\n", None])
async def test_another_kind_of_server_is_a_loss_in_bounded_time(answer):
    async def serve(reader, writer):
        await reader.read(100)
        if answer is None:
            await reader.read()
        else:
            writer.write(answer)
        writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    source = OpcUaSource(SourceSettings(f"opc.tcp://127.0.0.1:{port}/", timeout_s=0.3), [NODES])
    async with asyncio.timeout(5):
        with pytest.raises(SourceLost):
            await source.connect()
    server.close()
    await server.wait_closed()


async def test_a_server_that_ends_is_a_loss_after_the_last_changes():
    plant = await plant_on(plant_settings())
    await plant.server.start()
    source = OpcUaSource(anonymous(plant.settings), [replace(NODES, required_U=None)])
    await source.connect()
    await received(source, 1)
    plant.sample()
    await asyncio.sleep(0.2)
    await plant.server.stop()
    changes = await received(source, 1)
    assert of(changes, Signal.SEQUENCE).value.tolist() == [0]
    with pytest.raises(SourceLost):
        await received(source, 1)
    await source.close()
    await source.close()


async def test_after_a_cut_connect_works_again_and_counters_go_on(plant):
    async with Proxy(urlsplit(plant.url).port) as proxy:
        source = OpcUaSource(through(plant.settings, proxy), [NODES])
        await source.connect()
        await received(source, 1)
        proxy.cut()
        with pytest.raises(SourceLost):
            await received(source, 1)
        await source.connect()
        plant.sample()
        changes = await received(source, 1)
        assert of(changes, Signal.SEQUENCE).value.tolist() == [0]  # and nothing of before again
        assert source.counters.notifications >= 12
        await source.close()


@pytest.mark.waits
async def test_silence_longer_than_three_keep_alives_is_a_loss(plant):
    async with Proxy(urlsplit(plant.url).port) as proxy:
        settings = replace(through(plant.settings, proxy), timeout_s=0.8)
        source = OpcUaSource(settings, [NODES])
        await source.connect()
        await received(source, 1)
        proxy.stall()
        async with asyncio.timeout(6):
            with pytest.raises(SourceLost, match=r"silent for 1\.1 s"):
                await source.receive()
        await source.close()


async def test_a_short_stall_loses_nothing(plant):
    async with Proxy(urlsplit(plant.url).port) as proxy:
        source = OpcUaSource(through(plant.settings, proxy), [NODES])
        await source.connect()
        await received(source, 1)
        for k in range(100):
            if k == 20:
                proxy.stall()
            if k == 80:
                proxy.flow()
            plant.sample()
            await asyncio.sleep(0.005)
        changes = await received(source, 100)
        assert of(changes, Signal.SEQUENCE).value.tolist() == list(range(100))
        await source.close()


@pytest.mark.waits
async def test_keep_alives_prevent_a_loss_where_nothing_changes(source):
    await received(source, 1)
    with pytest.raises(TimeoutError):
        await received(source, 1, seconds=2.0)


async def test_a_lost_message_is_asked_for_again_and_comes_in_its_place(plant, monkeypatch):
    source = OpcUaSource(plant.settings, [NODES])
    await source.connect()
    monkeypatch.setattr(
        source._subscription, "_session", Losing(source._connection.session, {2, 3, 5})
    )
    for _ in range(100):
        plant.sample()
        await asyncio.sleep(0.005)
    changes = await received(source, 101)  # one came before the first sample
    numbers = of(changes, Signal.SEQUENCE)
    assert numbers.value[numbers.status == 0].tolist() == list(range(100))
    assert source.counters.missing_messages == 0
    await source.close()


@pytest.mark.waits
async def test_what_cannot_be_had_again_is_counted(plant, monkeypatch):
    source = OpcUaSource(plant.settings, [NODES])
    await source.connect()
    session = Losing(source._connection.session, {3, 4}, republish=False)
    monkeypatch.setattr(source._subscription, "_session", session)
    while session.seen < 6:
        plant.sample()
        await asyncio.sleep(0.005)
    await asyncio.sleep(0.1)
    assert source.counters.missing_messages == 2
    await source.close()


async def test_a_cancelled_receive_loses_nothing(plant, source):
    await received(source, 1)
    parts = []
    for _ in range(50):
        plant.sample()
        task = asyncio.create_task(source.receive())
        await asyncio.sleep(0.002)
        if task.done():
            parts.append(task.result())
        task.cancel()
    parts.append(await received(source, 50 - sum((p.item == 5).sum() for p in parts)))
    changes = DataChanges.concatenate(parts)
    assert of(changes, Signal.SEQUENCE).value.tolist() == list(range(50))


@pytest.mark.waits
async def test_a_full_buffer_holds_the_server_back_and_the_rest_comes_later(plant):
    settings = replace(plant.settings, buffer_limit=60, publish_requests=2)
    source = OpcUaSource(settings, [NODES])
    await source.connect()
    for _ in range(200):
        plant.sample()
        await asyncio.sleep(0.005)
    held = source.counters.notifications
    assert held < 200 * 6 / 2
    await asyncio.sleep(1.0)  # longer than three keep-alives: it is we who are silent
    assert source.counters.notifications == held
    changes = await received(source, 201)
    numbers = of(changes, Signal.SEQUENCE)
    assert numbers.value[numbers.status == 0].tolist() == list(range(200))
    await source.close()


async def test_items_are_created_in_as_many_calls_as_the_server_wants():
    plant = await plant_on(plant_settings(limits=Limits(operations=7)))
    valves = [replace(NODES, valve=f"V{k}", required_U=None) for k in range(5)]
    async with plant.server:
        source = OpcUaSource(anonymous(plant.settings), valves)
        await source.connect()
        plant.sample()
        async with asyncio.timeout(5):
            seen: set[int] = set()
            while seen != set(range(30)):
                seen |= set((await source.receive()).item.tolist())
        await source.close()


@pytest.mark.parametrize("security", [Security.BASIC256_SHA256, Security.AES256_SHA256_RSA_PSS])
async def test_a_secured_connection_needs_trust_on_both_sides(tmp_path, security):
    server_pki, client_pki = Pki(tmp_path / "server"), Pki(tmp_path / "client")
    own = ensure_certificate(client_pki, "urn:test:client", ("localhost",), "client")
    users, password = UserStore.one_time("operator", Role.OPERATOR, CHEAP)
    plant = await plant_on(
        ServerSettings(
            url="opc.tcp://127.0.0.1:0/plant/",
            application_uri="urn:test:plant",
            application_name="plant",
            namespace_uri="urn:plant",
            users=users,
            pki=server_pki,
        ),
        password,
    )
    async with plant.server:
        settings = replace(plant.settings, security=security, pki=client_pki, own=own)
        source = OpcUaSource(settings, [NODES])
        with pytest.raises(SourceRejected, match="not trusted") as error:
            await source.connect()
        (refused,) = client_pki.rejected.iterdir()
        assert refused.stem in str(error.value)
        trust(client_pki, refused.stem)
        trust(server_pki, own.certificate)
        await source.connect()
        plant.sample()
        assert of(await received(source, 2), Signal.SEQUENCE).value.tolist()[-1] == 0
        await source.close()


async def test_a_server_without_the_wanted_security_is_told_from_one_that_is_down(plant, tmp_path):
    pki = Pki(tmp_path)
    own = ensure_certificate(pki, "urn:test:client", ("localhost",), "client")
    settings = replace(plant.settings, security=Security.BASIC256_SHA256, pki=pki, own=own)
    with pytest.raises(SourceRejected, match=r"does not offer Basic256Sha256.*it offers None"):
        await OpcUaSource(settings, [NODES]).connect()


async def test_a_damaged_certificate_of_ours_is_named(plant, tmp_path):
    pki = Pki(tmp_path)
    own = ensure_certificate(pki, "urn:test:client", ("localhost",), "client")
    own.certificate.write_bytes(b"nothing")
    settings = replace(plant.settings, security=Security.BASIC256_SHA256, pki=pki, own=own)
    with pytest.raises(CertificateError, match=r"client\.der"):
        await OpcUaSource(settings, [NODES]).connect()


async def test_a_plain_asyncua_server_serves_as_well():
    server = Server()
    await server.init()
    server.set_endpoint("opc.tcp://127.0.0.1:0/")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    index = await server.register_namespace("urn:plant")
    for name in ("U", "p1", "p2", "Q"):
        await server.nodes.objects.add_variable(ua.NodeId(f"V1.{name}", index), name, 1.0)
    async with server:
        port = server.bserver.port
        settings = SourceSettings(f"opc.tcp://127.0.0.1:{port}/", publishing_interval_ms=20.0)
        source = OpcUaSource(settings, [replace(NODES, T=None, sequence=None, required_U=None)])
        await source.connect()
        got = await source.receive()
        assert sorted(got.item.tolist()) == [0, 1, 2, 3]
        await source.close()


@pytest.mark.parametrize(
    ("text", "node"),
    [
        ("i=85", ua.NodeId(85)),
        ("ns=3;i=70000", ua.NodeId(70_000, 3)),
        ("s=a=b;c", ua.NodeId("a=b;c")),
        ("nsu=urn:b;s=V.Q", ua.NodeId("V.Q", 1)),
        ("ns=2;b=AQI=", ua.NodeId(b"\x01\x02", 2, ua.NodeIdType.ByteString)),
    ],
)
async def test_node_ids_are_read_as_the_standard_writes_them(text, node):
    assert parse_node_id(text, ["urn:a", "urn:b"]) == node


@pytest.mark.parametrize("text", ["", "V1.Q", "ns=x;s=Q", "i=-1", "i=5000000000", "g=1", "ns=1;s="])
async def test_what_is_no_node_id_is_refused_before_anything_starts(text):
    with pytest.raises(ConfigurationError, match=r"is no NodeId; allowed are"):
        replace(NODES, Q=text)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"url": "http://x:1/"}, "opc.tcp://<host>:<port>"),
        ({"url": "opc.tcp://x/"}, "opc.tcp://<host>:<port>"),
        ({"url": "opc.tcp://x:99999/"}, "opc.tcp://<host>:<port>"),
        ({"url": "opc.tcp://me:secret@x:1/"}, "credentials belong to user and password"),
        ({"url": "opc.tcp://x:1/", "security": Security.BASIC256_SHA256}, "pki and own"),
    ],
)
async def test_settings_that_cannot_work_are_refused(fields, words):
    with pytest.raises(ConfigurationError, match=re.escape(words)) as error:
        SourceSettings(**fields)
    assert "secret" not in str(error.value)


async def test_sequence_numbers_begin_anew_after_the_last():
    assert subscriptions._ahead(2**32 - 2, 3) == 2


@pytest_asyncio.fixture(loop_scope="module")
async def unused_port():
    server = await asyncio.start_server(lambda *_: None, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    server.close()
    await server.wait_closed()
    return port
