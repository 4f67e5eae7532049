"""The fleet against a real Apache Kafka."""

import time

import pytest

from support.broker import artifacts, brokers
from support.processes import running, wait_for

pytest.importorskip("confluent_kafka")

from confluent_kafka import Producer
from confluent_kafka.admin import AdminClient, NewPartitions

from support.fleet import as_messages, day, feed
from support.kafka import everything, until
from valvemap.cli import run
from valvemap.kafka.catalogue import load_catalogue
from valvemap.kafka.commands import is_reply
from valvemap.kafka.group import Group, Rhythm
from valvemap.kafka.memory import MAGIC
from valvemap.kafka.result_blocks import read_results
from valvemap.kafka.settings import load_fleet

GROUPS = ("north.0", "north.1", "north.2")

pytestmark = [pytest.mark.broker, pytest.mark.timeout(600)]


@pytest.fixture(scope="module")
def broker(request, tmp_path_factory):
    jars = artifacts(request.config.cache.mkdir("kafka"))
    with brokers(jars, tmp_path_factory.mktemp("kafka")) as (node,):
        yield f"127.0.0.1:{node.port}"


def write(folder, broker, prefix, more="", replication=1):
    file = folder / "fleet.toml"
    file.write_text(
        f"[broker]\naddresses = {broker.split(',')}\n"
        f"[topics]\nprefix = '{prefix}'\npartitions = 3\nreplication = {replication}\n{more}",
        encoding="utf-8",
    )
    return file


def test_topics_are_made_once_and_every_contradiction_is_named(broker, tmp_path, capsys):
    file = str(write(tmp_path, broker, "made"))
    assert run(["fleet", "topics", "-c", file]) == 0
    made = capsys.readouterr().out.splitlines()
    assert made[0] == "made.samples: made, 3 partitions on 1 brokers"
    assert len(made) == 4
    assert run(["fleet", "topics", "-c", file]) == 0
    assert set(capsys.readouterr().out.splitlines()) == {
        f"made.{kind}: as configured" for kind in ("samples", "commands", "results", "state")
    }
    admin = AdminClient({"bootstrap.servers": broker})
    for done in admin.create_partitions([NewPartitions("made.commands", 4)]).values():
        done.result()
    file = str(write(tmp_path, broker, "made", more="samples_h = 1\n"))
    assert run(["fleet", "topics", "-c", file]) == 1
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 3
    assert "made.samples: retention.ms = 172800000, 3600000 wanted" in said[0]
    assert said[1].startswith("made.commands: 4 partitions, 3 wanted")
    assert "made.commands: retention.ms" in said[2]


def memories(broker, topic):
    """The newest memory of each group, as the state topic holds it."""
    found = {}
    for message in everything(broker, topic):
        value = message.value()
        if value is not None and MAGIC in value[:64]:
            name = next(n for n in GROUPS if n.encode() in message.key())
            found[name] = value[value.index(MAGIC) :]
    return found


def numbers(broker, topic):
    """The last block behind the results of each group."""
    found = {}
    for message in everything(broker, topic):
        if not is_reply(message.value()):
            block = read_results(message.value())
            found[block.group] = block.number
    return found


BLOCKS = 60


class Trial:
    """A catalogue, messages of its groups, and workers on them."""

    def __init__(self, folder, broker, name, replication=1, work="takeover_s = 6"):
        self.folder, self.broker, self.name = folder, broker, name
        estimators = "".join(
            f"[[valves.estimators]]\nkind = '{k}'\n" for k in ("RLS", "RML", "RBF")
        )
        valves = "".join(f"[[valves]]\nname = 'V{k}'\n{estimators}" for k in range(5))
        (folder / "north.toml").write_text(valves, encoding="utf-8")
        more = "[catalogue]\nvalves_per_group = 2\nsites = { north = 'north.toml' }\n"
        more += f"[work]\nresults_s = 0\n{work}\n"
        self.file = write(folder, broker, name, more, replication)
        assert run(["fleet", "topics", "-c", str(self.file)]) == 0
        self.known = load_catalogue(load_fleet(self.file).catalogue)
        self.days = {
            name: day(self.known.groups[name], BLOCKS, seed=k) for k, name in enumerate(GROUPS)
        }
        self._producer = Producer(
            {
                "bootstrap.servers": broker,
                "partitioner": "murmur2_random",
                "linger.ms": 0,
                "enable.idempotence": True,
            }
        )

    def send(self, begin, end):
        for name in GROUPS:
            for kind, key, packed in as_messages(self.days[name][begin:end]):
                self._producer.produce(f"{self.name}.{kind}", packed, key)
                self._producer.flush()
                time.sleep(0.002)  # the order of commands and samples is that of their times

    def worker(self, n):
        env = {"VALVEMAP_FLEET_WORK__STATE": str(self.folder / f"state{n}")}
        command = ("fleet", "work", "-c", str(self.file))
        return running(*command, env=env, log=self.log(n))

    def log(self, n):
        return self.folder / f"worker{n}.log"

    def until_each_is_behind(self, block):
        results = f"{self.name}.results"
        until(lambda: min(map(numbers(self.broker, results).get, GROUPS, [0] * 3)) >= block)

    def check_bits(self):
        """Results and memories are those of one machine that never stopped."""
        found = memories(self.broker, f"{self.name}.state")
        shown = {name: [] for name in GROUPS}
        for message in everything(self.broker, f"{self.name}.results"):
            shown[message.key().decode()].append(message.value())
        for name in GROUPS:
            alone = Group(self.known.groups[name], 1, Rhythm(0, 60_000_000_000))
            assert shown[name] == feed(alone, self.days[name])
            assert found[name] == alone.to_bytes()


def test_workers_that_are_killed_and_join_come_to_one_machines_bits(broker, tmp_path, capsys):
    trial = Trial(tmp_path, broker, "killed")
    with trial.worker(1) as first, trial.worker(2):
        trial.send(0, 20)
        trial.until_each_is_behind(5)
        trial.send(20, 40)
        first.kill()
        with trial.worker(3) as third:
            trial.send(40, BLOCKS + 4)
            trial.until_each_is_behind(BLOCKS)
            capsys.readouterr()
            assert run(["fleet", "status", "-c", str(trial.file)]) == 0
            head, *rows = (line.split() for line in capsys.readouterr().out.splitlines())
        assert head == ["group", "partition", "lag", "block", "age", "s", "kB", "owner"]
        assert [(row[0], row[2], row[3]) for row in rows] == [(g, "0", f"{BLOCKS}") for g in GROUPS]
        assert all(row[-1].endswith("@127.0.0.1") for row in rows)
        assert third.returncode == 0, trial.log(3).read_text()
    trial.check_bits()


def test_a_broker_that_is_killed_and_comes_back_loses_nothing(request, tmp_path):
    jars = artifacts(request.config.cache.mkdir("kafka"))
    with brokers(jars, tmp_path / "kafka") as (node,):
        trial = Trial(tmp_path, f"127.0.0.1:{node.port}", "away")
        with trial.worker(1) as worker:
            trial.send(0, 30)
            trial.until_each_is_behind(5)
            node.kill()
            wait_for(trial.log(1), "broker cannot be reached", worker)
            node.start()
            node.wait()
            trial.send(30, BLOCKS + 4)
            trial.until_each_is_behind(BLOCKS)
            assert worker.poll() is None
        assert worker.returncode == 0, trial.log(1).read_text()
        trial.check_bits()
        said = [line for line in trial.log(1).read_text().splitlines() if "info " not in line]
        assert len(said) <= 4, said  # that it is away, and what was lost by it


def test_a_commit_may_take_longer_than_a_worker_may_be_silent(broker, tmp_path):
    trial = Trial(tmp_path, broker, "rare", work="commit_s = 6\ntakeover_s = 2")
    with trial.worker(1) as worker:
        trial.send(0, 30)
        trial.until_each_is_behind(5)
        trial.send(30, BLOCKS + 4)
        trial.until_each_is_behind(BLOCKS)
        assert worker.poll() is None
    assert worker.returncode == 0, trial.log(1).read_text()
    trial.check_bits()
    assert all("info " in line for line in trial.log(1).read_text().splitlines())


@pytest.mark.soak
def test_one_of_three_brokers_that_is_killed_is_not_missed(request, tmp_path):
    jars = artifacts(request.config.cache.mkdir("kafka"))
    with brokers(jars, tmp_path / "kafka", 3) as nodes:
        addresses = ",".join(f"127.0.0.1:{node.port}" for node in nodes)
        trial = Trial(tmp_path, addresses, "three", 3)
        with trial.worker(1) as worker:
            trial.send(0, 30)
            trial.until_each_is_behind(5)
            nodes[0].kill()
            trial.send(30, BLOCKS + 4)
            trial.until_each_is_behind(BLOCKS)
        assert worker.returncode == 0, trial.log(1).read_text()
        trial.check_bits()


def test_topics_of_other_partitions_stop_a_worker_with_one_line(broker, tmp_path):
    trial = Trial(tmp_path, broker, "changed")
    admin = AdminClient({"bootstrap.servers": broker})
    for done in admin.create_partitions([NewPartitions("changed.samples", 4)]).values():
        done.result()
    with trial.worker(1) as worker:
        assert worker.wait(60) == 1
    said = trial.log(1).read_text().splitlines()
    assert len(said) == 1
    assert said[0].startswith("valvemap: changed.samples: 4 partitions, 3 wanted")
