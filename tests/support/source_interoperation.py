"""What our client must find at a plant's server of any stack.

A test module per stack subclasses :class:`SourceInteroperation` and says how to start its program
(see :mod:`support.peer`). Servers know the operations start, sample, command and stop. The plant
is one valve, namespace ``urn:plant``, nodes ``s=V1.<name>``: the signals U, p1, p2 (Float), Q, T
and Sequence (UInt32), a Text, an Array, and a Command that only the operator may write.
"""

import asyncio
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace

import pytest
from asyncua import ua

from guarded_opcua import OwnCertificate, Pki, ensure_certificate, rejected, trust
from support.peer import Peer
from support.processes import free_port
from support.proxy import Proxy
from valvemap.errors import SourceLost, SourceRejected
from valvemap.opcua_client.source_settings import Security, SourceSettings
from valvemap.opcua_source.client import OpcUaSource
from valvemap.opcua_source.source_nodes import ValveNodes
from valvemap.pipeline.data_changes import DataChanges
from valvemap.vocabulary.signals import Signal

START_MS = 1_800_000_000_000
STEP_MS = 10
PASSWORD = "correct horse"
HOSTS = ("localhost", "127.0.0.1")
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


@dataclass
class Plant:
    """A running server, and our client's settings for it."""

    peer: Peer
    proxy: Proxy
    settings: SourceSettings
    own: OwnCertificate
    theirs: OwnCertificate
    sampled: int = 0

    def through_proxy(self):
        return replace(self.settings, url=f"opc.tcp://127.0.0.1:{self.proxy.port}/plant/")

    async def sample(self, count=1, code=0, value=50.0):
        """Take samples of all signals, each 10 ms (of source time) after the one before."""
        for _ in range(count):
            time = START_MS + self.sampled * STEP_MS
            values = [value, 200.0, 100.0, 5.0, 40.0, self.sampled]
            await self.peer.ask("sample", values=values, code=code, time=time)
            self.sampled += 1
            await asyncio.sleep(0.002)


@asynccontextmanager
async def planted(folder, program):
    """Start a plant whose server trusts us; we trust it."""
    pki = Pki(folder / "ours")
    own = ensure_certificate(pki, "urn:test:valvemap", HOSTS, "valvemap")
    theirs = ensure_certificate(Pki(folder / "theirs"), "urn:test:plant", HOSTS, "plant")
    trust(pki, theirs.certificate)
    peer = await Peer.start(*program)
    try:
        started = await peer.ask(
            "start",
            port=free_port(),
            certificate=str(theirs.certificate),
            key=str(theirs.key),
            applicationUri="urn:test:plant",
            pki=str(folder / "server"),
            trusted=str(own.certificate),
            user="operator",
            password=PASSWORD,
        )
        settings = SourceSettings(
            started["url"],
            security=Security.BASIC256_SHA256,
            pki=pki,
            own=own,
            user="operator",
            password=PASSWORD,
            publishing_interval_ms=50.0,
            keep_alive_s=0.5,
            timeout_s=3.0,
        )
        async with Proxy(int(started["url"].rsplit(":", 1)[1].split("/")[0])) as proxy:
            yield Plant(peer, proxy, settings, own, theirs)
    finally:
        await peer.stop()


@asynccontextmanager
async def connected(settings, nodes=NODES):
    source = OpcUaSource(settings, [nodes])
    await source.connect()
    try:
        yield source
    finally:
        await source.close()


async def received(source, last):
    """Receive until sample ``last`` is there."""
    parts = []
    async with asyncio.timeout(10.0):
        while not any(last in part[part.item == Signal.SEQUENCE].value for part in parts):
            parts.append(await source.receive())
    return DataChanges.concatenate(parts)


def since(changes, signal, first):
    """Return the changes of a signal from sample ``first`` on."""
    t = (START_MS + first * STEP_MS) * 1_000_000
    return changes[(changes.item == signal) & (changes.source_time >= t)]


class SourceInteroperation:
    """The list that every stack goes through."""

    async def test_every_sample_of_constant_signals_arrives_with_its_exact_time(self, plant):
        async with connected(plant.settings) as source:
            first = plant.sampled
            await plant.sample(100)
            changes = await received(source, plant.sampled - 1)
            counters = source.counters
        times = [(START_MS + k * STEP_MS) * 1_000_000 for k in range(first, first + 100)]
        for signal in Signal:
            got = since(changes, signal, first)
            assert got.source_time.tolist() == times
            assert (got.status == 0).all()
        assert since(changes, Signal.SEQUENCE, first).value.tolist() == [*range(first, first + 100)]
        assert set(since(changes, Signal.P2, first).value) == {100.0}
        assert counters.missing_messages == counters.overflows == counters.undecodable == 0

    async def test_a_bad_status_arrives_as_sent(self, plant):
        async with connected(plant.settings) as source:
            first = plant.sampled
            await plant.sample(code=ua.StatusCodes.BadSensorFailure)
            await plant.sample()
            changes = await received(source, plant.sampled - 1)
        got = since(changes, Signal.Q, first)
        assert got.status.tolist() == [ua.StatusCodes.BadSensorFailure, 0]

    async def test_the_stronger_policy_works_too(self, plant):
        settings = replace(plant.settings, security=Security.AES256_SHA256_RSA_PSS)
        async with connected(settings) as source:
            await plant.sample()
            await received(source, plant.sampled - 1)

    @pytest.mark.parametrize(
        ("wrong", "words"),
        [
            ({"Q": "nsu=urn:plant;s=V1.X"}, ["s=V1.X' (Q of valve V1)", "does not exist"]),
            ({"Q": "nsu=urn:plan;s=V1.Q"}, ["s=V1.Q'", "no namespace urn:plan;", "urn:plant"]),
            ({"T": "nsu=urn:plant;s=V1.Text"}, ["T of valve V1", "type String"]),
            ({"p1": "nsu=urn:plant;s=V1.Array"}, ["p1 of valve V1", "array", "scalar is needed"]),
            ({"U": "nsu=urn:plant;s=V1"}, ["U of valve V1", "class Object", "Variable is needed"]),
            ({"required_U": "nsu=urn:plant;s=V1.U"}, ["required_U of valve V1", "be written"]),
        ],
    )
    async def test_a_wrong_node_is_named(self, plant, wrong, words):
        source = OpcUaSource(plant.settings, [replace(NODES, **wrong)])
        with pytest.raises(SourceRejected) as error:
            await source.connect()
        assert all(word in str(error.value) for word in words)
        assert "\n" not in str(error.value)

    async def test_required_U_is_written_to_its_node(self, plant):
        async with connected(plant.settings) as source:
            await source.write_required_U(0, 42.5)
        assert await plant.peer.ask("command") == {"value": 42.5}

    async def test_who_may_not_write_is_told_before_anything_starts(self, plant):
        settings = replace(plant.settings, user=None, password=None)
        with pytest.raises(SourceRejected, match="cannot be written by this user"):
            await OpcUaSource(settings, [NODES]).connect()

    async def test_a_wrong_password_is_refused_and_never_shown(self, plant):
        settings = replace(plant.settings, password="hunter2hunter2")
        with pytest.raises(SourceRejected, match="user or password") as error:
            await OpcUaSource(settings, [NODES]).connect()
        assert "hunter2" not in str(error.value)

    async def test_an_unknown_server_waits_for_trust(self, plant, tmp_path):
        pki = Pki(tmp_path)
        pki.make_folders()
        settings = replace(plant.settings, pki=pki)
        with pytest.raises(SourceRejected, match="not trusted"):
            await OpcUaSource(settings, [NODES]).connect()
        (refused,) = rejected(pki)
        trust(pki, refused.stem)
        async with connected(settings):
            pass

    async def test_a_server_that_does_not_trust_us_is_told_from_one_that_is_down(
        self, plant, tmp_path
    ):
        stranger = ensure_certificate(Pki(tmp_path), "urn:test:stranger", HOSTS, "stranger")
        settings = replace(plant.settings, own=stranger)
        with pytest.raises((SourceRejected, SourceLost), match="trust") as error:
            await OpcUaSource(settings, [NODES]).connect()
        assert plant.settings.url in str(error.value)

    async def test_after_a_cut_connect_works_again(self, plant):
        async with connected(plant.through_proxy()) as source:
            await plant.sample()
            await received(source, plant.sampled - 1)
            plant.proxy.cut()
            with pytest.raises(SourceLost):
                await received(source, plant.sampled)
            await source.connect()
            await plant.sample(5)
            await received(source, plant.sampled - 1)

    async def test_a_short_stall_loses_nothing(self, plant):
        async with connected(plant.through_proxy()) as source:
            first = plant.sampled
            await plant.sample(20)
            plant.proxy.stall()
            await plant.sample(60)
            plant.proxy.flow()
            await plant.sample(20)
            changes = await received(source, plant.sampled - 1)
            counters = source.counters
        assert since(changes, Signal.SEQUENCE, first).value.tolist() == [*range(first, first + 100)]
        assert counters.missing_messages == 0

    async def test_silence_longer_than_three_keep_alives_is_a_loss(self, plant):
        settings = replace(plant.through_proxy(), timeout_s=0.3, keep_alive_s=0.1)
        source = OpcUaSource(settings, [NODES])
        async with asyncio.timeout(10.0):
            await source.connect()
            plant.proxy.stall()
            with pytest.raises(SourceLost, match="silent for"):
                await received(source, plant.sampled)
            await source.close()
            plant.proxy.flow()
