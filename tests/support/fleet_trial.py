"""Workers on a real broker: a catalogue, messages of its groups, and their results."""

import time
from contextlib import suppress

from confluent_kafka import Producer

from support.fleet import as_messages, day, feed
from support.kafka import everything, until
from support.processes import running
from valvemap.cli import run
from valvemap.errors import BlockError
from valvemap.kafka.catalogue import load_catalogue
from valvemap.kafka.commands import is_reply
from valvemap.kafka.group import Group, Rhythm
from valvemap.kafka.memory import MAGIC
from valvemap.kafka.result_blocks import read_results
from valvemap.kafka.settings import load_fleet

GROUPS = ("north.0", "north.1", "north.2")


def write(folder, broker, prefix, more="", replication=1):
    file = folder / "fleet.toml"
    file.write_text(
        f"[broker]\naddresses = {broker.split(',')}\n"
        f"[topics]\nprefix = '{prefix}'\npartitions = 3\nreplication = {replication}\n{more}",
        encoding="utf-8",
    )
    return file


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
    """The last block behind the results of each group; what cannot be read is left aside."""
    found = {}
    for message in everything(broker, topic):
        packed = message.value()
        if packed and not is_reply(packed):
            with suppress(BlockError):
                block = read_results(packed)
                found[block.group] = max(block.number, found.get(block.group, 0))
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

    def worker(self, n, *options):
        env = {"VALVEMAP_FLEET_WORK__STATE": str(self.folder / f"state{n}")}
        command = ("fleet", "work", "-c", str(self.file), *options)
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
