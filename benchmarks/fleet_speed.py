"""A fleet's workers on a real Kafka: ``python -m benchmarks.fleet_speed [PART ...]``.

Parts: state, rls, three, default, two, latency, takeover; without any, all. Broker, workers and the
bare client share this machine's cores. The bare client (:mod:`benchmarks.fleet_client`) does what a
worker does, with confluent-kafka's transactions and a private changelog. Needs Java and Maven.
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from confluent_kafka import Consumer, KafkaException, Producer, TopicPartition

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.broker import artifacts, brokers
from support.fleet import block, group
from valvemap.kafka.blocks import write_samples
from valvemap.kafka.catalogue import Catalogue, load_catalogue
from valvemap.kafka.result_blocks import read_results
from valvemap.kafka.settings import FleetConfig, load_fleet
from valvemap.kafka.topics import create_or_check

GROUPS, VALVES, SAMPLES = 8, 50, 20  # 400 valves; a block is 1,000 samples
KINDS = {"rls": ("RLS",), "three": ("RLS", "RML", "RBF"), "default": ("RLS", "RML", "RBF", "Auto")}
BLOCKS = {"rls": 300, "three": 150, "default": 500}  # of each group; 500: 10,000 samples a valve
BLOCKS_OF_TWO = 1_200  # with two workers: a young broker takes a core for itself
COMMIT_S, QUICK_COMMIT_S = 1.0, 0.05  # s between commits: where much is learnt, where results hurry
WARM = 3  # blocks of each group before anything is measured
CACHE = Path.home() / ".cache" / "valvemap" / "kafka"
BARS = {"rls": 500_000, "three": 180_000, "default": 40_000, "two": 800_000}
LATENCY_S, LATENCY_HZ = 30.0, 50.0  # blocks/s: a tenth of one worker's rate
SETTLING_S = 90.0  # of the same before: a young broker compiles, and takes a core for that
CLOCK, PER_CORE = "samples/s, by the clock", "samples/s per worker core (processor's time)"
_TICKS = os.sysconf("SC_CLK_TCK")


@dataclass
class Plant:
    """A broker with topics, and the catalogue of one kind of estimators."""

    folder: Path
    broker: str
    name: str
    config: FleetConfig
    catalogue: Catalogue

    def topic(self, kind: str) -> str:
        return f"{self.config.topics.prefix}.{kind}"


def set_up(
    folder: Path,
    broker: str,
    name: str,
    kind: str,
    results_s: float = 1.0,
    commit_s: float = COMMIT_S,
) -> Plant:
    own = folder / name
    own.mkdir()
    estimators = "".join(f"[[valves.estimators]]\nkind = '{one}'\n" for one in KINDS[kind])
    site = "".join(f"[[valves]]\nname = 'V{k}'\n{estimators}" for k in range(GROUPS * VALVES))
    (own / "site.toml").write_text(site, encoding="utf-8")
    (own / "fleet.toml").write_text(
        f"[broker]\naddresses = ['{broker}']\n[topics]\nprefix = '{name}'\npartitions = {GROUPS}\n"
        f"replication = 1\n[catalogue]\nvalves_per_group = {VALVES}\nsites = {{s = 'site.toml'}}\n"
        f"[work]\nresults_s = {results_s}\ncommit_s = {commit_s}\ntakeover_s = 6\n",
        encoding="utf-8",
    )
    config = load_fleet(own / "fleet.toml")
    list(create_or_check(config))
    return Plant(own, broker, name, config, load_catalogue(config.catalogue))


class Feeder:
    """Sends blocks; each group has one partition, so that two workers share evenly."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._producer = Producer({"bootstrap.servers": plant.broker, "compression.type": "none"})
        self._numbers = dict.fromkeys(plant.catalogue.groups, 0)

    def send(self, blocks: int) -> None:
        self.send_prepared(self.prepared(blocks))

    def prepared(self, blocks: int) -> list[tuple[int, bytes, bytes]]:
        """The next blocks of each group: partition, key, message."""
        found = []
        for _ in range(blocks):
            for partition, (name, plan) in enumerate(self._plant.catalogue.groups.items()):
                n = self._numbers[name] = self._numbers[name] + 1
                lengths = [SAMPLES] * len(plan.plans)
                packed = write_samples(block(plan, n, lengths, seed=n % 16, first=n * SAMPLES))
                found.append((partition, name.encode(), packed))
        return found

    def send_prepared(self, messages: list[tuple[int, bytes, bytes]]) -> None:
        for partition, key, packed in messages:
            self._producer.produce(self._plant.topic("samples"), packed, key, partition)
            self._producer.poll(0)
        self._producer.flush()


@contextmanager
def process(*command: str, env: dict[str, str] | None = None, log: Path) -> Iterator[int]:
    """One process, stopped at the end."""
    one_thread = {"NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    with log.open("wb") as out:
        running = subprocess.Popen(
            [sys.executable, "-m", *command],
            stdout=out,
            stderr=out,
            env={**os.environ, **one_thread, **(env or {})},
        )
    try:
        yield running.pid
    finally:
        if running.poll() is None:
            running.send_signal(signal.SIGTERM)
            try:
                running.wait(30)
            except subprocess.TimeoutExpired:
                running.kill()
                running.wait()


@contextmanager
def worker(plant: Plant, n: int) -> Iterator[int]:
    env = {"VALVEMAP_FLEET_WORK__STATE": str(plant.folder / f"state{n}")}
    file = str(plant.folder / "fleet.toml")
    command = ("valvemap", "fleet", "work", "-c", file)
    with process(*command, env=env, log=plant.folder / f"worker{n}.log") as pid:
        yield pid


@cache
def _reader(broker: str, group: str) -> Consumer:
    quiet = {"log_level": 0}
    return Consumer({"bootstrap.servers": broker, "group.id": group, **quiet})


def learnt(plant: Plant, consumer: str = "work") -> dict[int, int]:
    """How far a group of consumers has committed, by partition."""
    reader = _reader(plant.broker, f"{plant.config.topics.prefix}.{consumer}")
    places = [TopicPartition(plant.topic("samples"), p) for p in range(GROUPS)]
    try:
        return {p.partition: max(p.offset, 0) for p in reader.committed(places, timeout=20)}
    except KafkaException:  # the group's coordinator is not there yet
        return dict.fromkeys(range(GROUPS), 0)


def cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


def rate(
    plant: Plant, feeder: Feeder, pids: list[int], blocks: int, consumer: str
) -> tuple[float, float]:
    """Samples/s by the clock, and by the processors' time of those who learn.

    Once they have learnt from three blocks of each group: work that is done once is done then.
    """
    messages = feeder.prepared(blocks)
    _until(lambda: min(learnt(plant, consumer).values()) >= WARM, 240.0)
    began, used = time.monotonic(), sum(map(cpu_s, pids))
    feeder.send_prepared(messages)
    _until(lambda: min(learnt(plant, consumer).values()) >= WARM + blocks, 400.0, 0.05)
    samples = GROUPS * blocks * VALVES * SAMPLES
    return samples / (time.monotonic() - began), samples / (sum(map(cpu_s, pids)) - used)


def speed(folder: Path, broker: str, kind: str) -> dict[str, float]:
    """One worker, and the bare client, on the same blocks."""
    plant = set_up(folder, broker, f"{kind}-bare", kind)
    feeder = Feeder(plant)
    feeder.send(WARM)
    file = str(plant.folder / "fleet.toml")
    with process("benchmarks.fleet_client", file, log=plant.folder / "bare.log") as pid:
        bare, bare_cpu = rate(plant, feeder, [pid], BLOCKS[kind], "bare")
    ours, ours_cpu = workers(folder, broker, kind, 1, BLOCKS[kind])
    return {
        CLOCK: ours,
        PER_CORE: ours_cpu,
        "bare client, samples/s, by the clock": bare,
        "bare client, samples/s per core": bare_cpu,
        "ratio to the bare client, per core": ours_cpu / bare_cpu,
    }


def workers(folder: Path, broker: str, kind: str, number: int, blocks: int) -> tuple[float, float]:
    """Samples/s of some workers by the clock, and by their processors' time."""
    plant = set_up(folder, broker, f"{kind}{number}", kind)
    feeder = Feeder(plant)
    feeder.send(WARM)
    with ExitStack() as stack:
        pids = [stack.enter_context(worker(plant, n)) for n in range(number)]
        return rate(plant, feeder, pids, blocks, "work")


def latency(folder: Path, broker: str) -> dict[str, float]:
    """From a block sent to its results received, a result with every block."""
    plant = set_up(folder, broker, "latency", "rls", 0.0, QUICK_COMMIT_S)
    feeder, sent = Feeder(plant), {}
    reader = Consumer({"bootstrap.servers": broker, "group.id": "latency.reader"})
    topic = plant.topic("results")
    reader.assign([TopicPartition(topic, p, 0) for p in range(GROUPS)])
    took: list[float] = []

    def receive(until: float) -> None:
        while (left := until - time.monotonic()) > 0:
            message = reader.poll(left)
            if message is not None and message.error() is None:
                number = read_results(message.value()).number
                if number in sent:
                    took.append(time.monotonic() - sent[number])

    with worker(plant, 1):
        feeder.send(3)
        _until(lambda: min(learnt(plant).values()) >= 3, 240.0)
        rounds, before = (int(s * LATENCY_HZ / GROUPS) for s in (LATENCY_S, SETTLING_S))
        messages = feeder.prepared(before + rounds)
        began = time.monotonic()
        for k in range(before + rounds):
            if k == before:
                took.clear()
            sent[4 + k] = time.monotonic()
            feeder.send_prepared(messages[k * GROUPS : (k + 1) * GROUPS])
            receive(began + (k + 1) * GROUPS / LATENCY_HZ)
        receive(time.monotonic() + 3.0)
    reader.close()
    p50, p99 = np.percentile(took, (50, 99)) * 1e3
    return {"p50, ms": p50, "p99, ms": p99, "results": len(took), "blocks": rounds * GROUPS}


def takeover(folder: Path, broker: str) -> dict[str, float]:
    """kill -9 one of two workers while samples come: until every group is learnt again."""
    plant = set_up(folder, broker, "takeover", "rls", 0.0, QUICK_COMMIT_S)
    feeder = Feeder(plant)
    with worker(plant, 1) as one, worker(plant, 2):
        feeder.send(5)
        _until(lambda: min(learnt(plant).values()) >= 5, 240.0)
        time.sleep(3.0)
        os.kill(one, signal.SIGKILL)
        killed = time.monotonic()
        feeder.send(5)
        _until(lambda: min(learnt(plant).values()) >= 10, 120.0, 0.1)
        return {"seconds until every group is learnt again": time.monotonic() - killed}


def state() -> dict[str, float]:
    """Bytes that a valve's memory takes, and how long packing it does, on one core."""
    found = {}
    with tempfile.TemporaryDirectory() as name:
        for kind, kinds in KINDS.items():
            estimators = "".join(f"[[valves.estimators]]\nkind = '{one}'\n" for one in kinds)
            site = "".join(f"[[valves]]\nname = 'V{k}'\n{estimators}" for k in range(VALVES))
            Path(name, "site.toml").write_text(site, encoding="utf-8")
            fleet = Path(name, "fleet.toml")
            fleet.write_text("[catalogue]\nsites = {s = 'site.toml'}\n", encoding="utf-8")
            (plan,) = load_catalogue(load_fleet(fleet).catalogue).groups.values()
            one = group(plan)
            for k in range(10):
                lengths = [SAMPLES] * VALVES
                list(one.take(block(plan, k + 1, lengths, seed=k, first=k * SAMPLES)))
            began = time.process_time()
            for _ in range(20):
                packed = one.to_bytes()
            took = (time.process_time() - began) / 20
            found[f"{kind}: bytes a valve"] = len(packed) / VALVES
            found[f"{kind}: pack a valve, µs"] = took / VALVES * 1e6
    return found


def _until(condition: Callable[[], bool], seconds: float, pause: float = 0.1) -> None:
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError("it did not come to that")
        time.sleep(pause)


def main(arguments: list[str]) -> int:
    """Measure and print."""
    parts = arguments or ["state", "rls", "three", "default", "two", "latency", "takeover"]
    CACHE.mkdir(parents=True, exist_ok=True)
    if "state" in parts:
        _show("state", state())
    parts = [part for part in parts if part != "state"]
    if not parts:
        return 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with brokers(artifacts(CACHE), folder) as (node,):
            broker = f"127.0.0.1:{node.port}"
            for part in parts:
                match part:
                    case "latency":
                        found = latency(folder, broker)
                    case "takeover":
                        found = takeover(folder, broker)
                    case "two":
                        both = workers(folder, broker, "rls", 2, BLOCKS_OF_TWO)
                        found = dict(zip((CLOCK, PER_CORE), both, strict=True))
                    case _:
                        found = speed(folder, broker, part)
                _show(part, found)
    return 0


def _show(part: str, found: dict[str, float]) -> None:
    bar = f" (bar {BARS[part]:,} samples/s)" if part in BARS else ""
    print(f"{part}{bar}")
    for name, value in found.items():
        print(f"  {name:50} {value:14,.2f}", flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
