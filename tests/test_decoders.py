"""Every decoder raises its announced exceptions only, in milliseconds, whatever the bytes."""

import os
import random
import time
import zlib
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from support.decoders import decoders
from support.structural import mutant

TRIES = 3  # the quickest counts: others work on this machine, too
IDLE_S = 0.0032  # processor time of `yardstick` on an idle core
LONG = 1_000_000  # inputs


pytestmark = pytest.mark.filterwarnings("ignore")  # of numpy and cryptography: no exceptions


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """All decoders, by name; their files lie in memory where that can be had."""
    memory = Path("/dev/shm")  # noqa: S108 - a private folder below it
    if not os.access(memory, os.W_OK):
        yield decoders(tmp_path_factory.mktemp("decoders"))
        return
    with TemporaryDirectory(prefix="valvemap-decoders-", dir=memory) as folder:
        yield decoders(Path(folder))


NAMES = (
    *("server: requests", "server: values", "server: index ranges"),
    *("client: publish responses", "client: republish responses", "client: history responses"),
    *("client: data changes", "client: members of structures", "client: other responses"),
    *("client: faults", "client: NodeIds"),
    *("client: positions", "state: Valvistor.RLS", "state: Valvistor.RML"),
    *("state: Valvistor.RBF", "state: Valvistor.Auto", "state: Valvistor.Diagnostics"),
    *("state: Valvistor.Signals", "state: Valvistor.Baseline", "state: Valvistor.Alarms"),
    *("state: Valvistor.Recommended", "state: shared meters", "state: Valvistor.Dynamics"),
    *("state: Service.Alarms", "state: arrivals", "file: CSV", "file: CSV.gz", "file: Parquet"),
    *("file: points", "file: users", "file: configuration", "file: certificates"),
    *("file: trusted certificates", "file: revocation lists", "wire: certificates"),
    *("page: requests", "Sparkplug: states", "Sparkplug: commands", "Sparkplug: device commands"),
    *(
        "state: arrays",
        "state: axes",
        "state: searches of axes",
        "state: watches of axes",
        "state: alarms of axes",
        "file: models",
        "history: blocks",
        "history: sealed blocks",
        "history: alarms",
        "MQTT: packets",
    ),
    *(
        "MQTT: client",
        "Kafka: states",
        "Kafka: samples",
        "Kafka: results",
        "Kafka: commands",
        "Kafka: replies",
        "Kafka: statistics",
        "Kafka: memories",
    ),
)


def took(decoder, data):
    """Processor time, s; announced exceptions are suppressed."""
    began = time.thread_time()
    with suppress(*decoder.announced):
        decoder.decode(data)
    return time.thread_time() - began


def yardstick():
    """Processor time, s, of some work that is always the same."""
    began = time.thread_time()
    total = 0
    for i in range(100_000):
        total += i
    return time.thread_time() - began


def is_slow(decoder, data):
    """Whether it takes too long, where a busy core is allowed as much more as it needs for all."""
    quickest = min(took(decoder, data) for _ in range(TRIES))
    return quickest > decoder.longest_s * max(1.0, min(yardstick() for _ in range(TRIES)) / IDLE_S)


def withstands(name, decoder, inputs):
    seeds = decoder.seeds()
    dice = random.Random(zlib.crc32(name.encode()))
    for _ in range(inputs):
        data = decoder.seal(mutant(dice.choice(seeds), seeds, dice))
        try:
            slow = took(decoder, data) > decoder.longest_s and is_slow(decoder, data)
        except Exception as error:  # noqa: BLE001 - the input is said with it
            pytest.fail(f"{name}: {type(error).__name__}: {error}: {data[:300].hex()}")
        assert not slow, f"{name}: slow: {data[:300].hex()}"


def test_every_decoder_of_the_table_is_tried(table):
    assert set(NAMES) == set(table)


@pytest.mark.parametrize("name", NAMES)
def test_its_seeds_are_valid(table, name):
    decoder = table[name]
    for seed in decoder.seeds():
        if name != "client: faults":  # which are raised
            decoder.decode(seed)


@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", NAMES)
def test_only_what_is_announced_is_raised(table, name):
    withstands(name, table[name], table[name].inputs)


@pytest.mark.soak
@pytest.mark.timeout(7_200)
@pytest.mark.parametrize("name", NAMES)
def test_only_what_is_announced_is_raised_for_long(table, name):
    withstands(name, table[name], LONG)
