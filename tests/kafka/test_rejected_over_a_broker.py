"""Over a real Kafka: hostile messages end nothing; they are dead letters that name their place."""

import asyncio
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from support.broker import artifacts, brokers

pytest.importorskip("confluent_kafka")

from asyncua import Client, ua
from confluent_kafka import Producer

from support import fleet_server
from support import hostile_messages as hostile
from support.fleet import block, feed
from support.fleet_trial import BLOCKS, GROUPS, Trial, memories
from support.kafka import everything, until
from support.processes import free_port, program, wait_for
from valvemap.cli import run
from valvemap.kafka.blocks import write_samples
from valvemap.kafka.commands import is_reply
from valvemap.kafka.group import Group, Rhythm
from valvemap.kafka.memory import read_memory, write_memory

pytestmark = [pytest.mark.broker, pytest.mark.timeout(600)]

PASSWORD = "a long enough password"
MOST_GROWTH_KB = 256_000  # of a process, by all hostile messages together


@pytest.fixture(scope="module")
def broker(request, tmp_path_factory):
    jars = artifacts(request.config.cache.mkdir("kafka"))
    with brokers(jars, tmp_path_factory.mktemp("kafka")) as (node,):
        yield f"127.0.0.1:{node.port}"


class Attacker:
    """Sends any message; the broker allows it."""

    def __init__(self, broker, prefix):
        self._prefix = prefix
        self._producer = Producer(
            {
                "bootstrap.servers": broker,
                "partitioner": "murmur2_random",
                "message.max.bytes": 16_000_000,
            }
        )
        self.sent = {"samples": [], "commands": [], "results": []}

    def send(self, kind, packed, key=b"north.0"):
        self._producer.produce(f"{self._prefix}.{kind}", packed, key)
        self._producer.flush()
        self.sent[kind].append(packed)


def largest_kB(process):
    """The most memory that a process ever had, kB."""
    status = Path(f"/proc/{process.pid}/status").read_text(encoding="utf-8")
    return int(next(line for line in status.splitlines() if line.startswith("VmHWM")).split()[1])


async def read(port, names):
    """Values of the results server's nodes, as a client reads them."""
    client = Client(f"opc.tcp://127.0.0.1:{port}/valvemap/service/", timeout=60.0)
    client.set_user("operator")
    client.set_password(PASSWORD)
    async with client:
        nodes = [client.get_node(ua.NodeId(name, 1)) for name in names]
        found = [await one.read_data_value(raise_on_bad_status=False) for one in nodes]
        return [one.Value.Value for one in found]


def samples(port, names):
    return asyncio.run(read(port, [f"{name}.RLS.SampleCount" for name in names]))


def alarm(port):
    """Whether the alarm of rejected messages is active, and its text."""
    names = [f"Service.Alarms.MessagesRejected.{one}" for one in ("Active", "Text")]
    return asyncio.run(read(port, names))


def bad_rows(trial, good_results):
    sent = write_samples(block(trial.known.groups[GROUPS[0]], 3, (20, 20)))
    yield from (("commands", packed) for _, packed in hostile.commands() if len(packed) < 9e5)
    yield from (("samples", packed) for _, packed in hostile.blocks(sent))
    yield from (("results", packed) for _, packed in hostile.results(good_results))


def test_hostile_messages_end_neither_worker_nor_server_and_honest_ones_are_learnt_bit_for_bit(
    broker, tmp_path, capsys
):
    trial, port = Trial(tmp_path, broker, "hostile"), free_port()
    attacker = Attacker(broker, "hostile")
    command = sys.executable, "-u", Path(fleet_server.__file__), trial.file, str(port), PASSWORD
    log = tmp_path / "server.log"
    with trial.worker(1) as worker, program(*command, log=log) as server:
        wait_for(log, "results served", server, 240.0)
        trial.send(0, 20)
        trial.until_each_is_behind(15)
        assert alarm(port)[0] is False
        honest = everything(broker, "hostile.results")
        good = next(m.value() for m in honest if m.key() == b"north.0" and not is_reply(m.value()))
        before = largest_kB(worker), largest_kB(server)
        began = time.monotonic()
        for k, (kind, packed) in enumerate(bad_rows(trial, good)):
            attacker.send(kind, packed)
            trial.send(20 + k % 20, 21 + k % 20) if k < 20 else None
        attacker.send("samples", b"of no key", None)
        attacker.send("samples", b"of no group", b"south.9")
        attacker.send("commands", None)
        trial.send(40, BLOCKS + 4)
        trial.until_each_is_behind(BLOCKS)
        took = time.monotonic() - began
        expected = {}
        for name in GROUPS:
            alone = Group(trial.known.groups[name], 1, Rhythm(0, 60_000_000_000))
            feed(alone, trial.days[name])
            for plan in alone.plan.plans:
                expected[plan.name] = alone.identification.valves.lane(plan.name, "RLS").count
        until(lambda: samples(port, expected) == [*expected.values()], 60.0)
        every = sum(map(len, attacker.sent.values()))
        until(lambda: f"{every} messages were rejected (" in (alarm(port)[1] or ""), 60.0)
        assert alarm(port)[0] is True
        grown = [
            now - was for now, was in zip(map(largest_kB, (worker, server)), before, strict=True)
        ]
        capsys.readouterr()
        assert run(["fleet", "status", "-c", str(trial.file)]) == 0
        status = capsys.readouterr().out.splitlines()
    assert worker.returncode == 0, trial.log(1).read_text()
    assert server.returncode == 0, log.read_text()
    sys.stderr.write(f"{took:.1f} s, grown by {grown} kB\n")
    assert max(grown) < MOST_GROWTH_KB
    check_bits(trial, attacker)
    check_dead_letters(broker, attacker)
    head = status[0].replace("age s", "age").split()
    refused = int(status[1].split()[head.index("refused")])
    without_group = 2
    sent = len(attacker.sent["samples"]) + len(attacker.sent["commands"])
    assert refused == sent - without_group
    for text in (trial.log(1).read_text(), log.read_text()):
        assert "Traceback" not in text


def check_bits(trial, attacker):
    found = memories(trial.broker, f"{trial.name}.state")
    shown = {name: [] for name in GROUPS}
    for message in everything(trial.broker, f"{trial.name}.results"):
        if message.value() not in attacker.sent["results"]:
            shown[message.key().decode()].append(message.value())
    for name in GROUPS:
        alone = Group(trial.known.groups[name], 1, Rhythm(0, 60_000_000_000))
        assert shown[name] == feed(alone, trial.days[name])
        ours, theirs = (
            write_memory(replace(read_memory(one), counts={}))
            for one in (found[name], alone.to_bytes())
        )
        assert ours == theirs


def check_dead_letters(broker, attacker):
    """Each hostile message is one, with its reason and place; no honest one is."""
    at = {
        (message.topic(), message.partition(), message.offset()): message.value() or b""
        for kind in attacker.sent
        for message in everything(broker, f"hostile.{kind}")
    }
    found = []
    for letter in everything(broker, "hostile.rejected"):
        said = dict(letter.headers())
        assert said["reason"]
        place = said["topic"].decode(), int(said["partition"]), int(said["offset"])
        assert at[place][:65_536] == (letter.value() or b"")
        assert int(said["size"]) == len(at[place])
        found.append(at[place])
    sent = [one or b"" for some in attacker.sent.values() for one in some]
    assert sorted(found) == sorted(sent)
