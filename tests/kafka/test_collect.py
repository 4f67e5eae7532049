"""Whatever is killed, and whenever: each sample is in one block, and each block is sent."""

import asyncio
import json
from typing import ClassVar

import numpy as np
import pytest
import structlog

pytest.importorskip("pyarrow")

from support.fleet import site
from support.plant import START, as_changes, plant
from valvemap.clock import ManualClock
from valvemap.errors import ConfigurationError
from valvemap.kafka.blocks import read_samples
from valvemap.kafka.catalogue import catalogue_of, site_of
from valvemap.kafka.collector import Collector
from valvemap.kafka.settings import CatalogueConfig, CollectConfig, FleetConfig, TopicsConfig
from valvemap.kafka.spool import Spool
from valvemap.model.samples import Samples
from valvemap.pipeline.data_changes import DataChanges
from valvemap.runtime.sources import Part, Sources
from valvemap.vocabulary.signals import PER_VALVE

VALVES, SAMPLES, PER_GROUP = 5, 400, 2
CONFIG = FleetConfig(
    catalogue=CatalogueConfig(valves_per_group=PER_GROUP), collect=CollectConfig(commit_s=0.1)
)


class Source:
    """Messages by number; what was not committed is there for who comes again."""

    clock_offset_s = 0.0
    remarks: ClassVar[dict] = {}

    def __init__(self):
        self.at, self.mark, self.safe = 0, None, 0

    def hand_out(self, messages, n):
        some = messages[self.at : self.at + n]
        self.at = self.mark = self.at + len(some)
        return DataChanges.concatenate(some)

    def hold_back(self):
        pass

    def commit(self, mark):
        self.safe = mark

    def position(self, mark):
        return json.dumps(mark).encode()

    def resume_at(self, position):
        self.at = json.loads(position)
        return True


@pytest.fixture(scope="module")
def truth():
    return [plant(SAMPLES, seed=k) for k in range(VALVES)]


@pytest.fixture(scope="module")
def messages(truth):
    """What the source publishes: a few signals of a few valves in each message."""
    rng = np.random.default_rng(5)
    each = [as_changes(one) for one in truth]
    changes = DataChanges.concatenate(
        [
            DataChanges(one.item + np.int32(k * PER_VALVE), *list(vars(one).values())[1:])
            for k, one in enumerate(each)
        ]
    )
    times = changes.source_time + rng.integers(0, 40_000_000, len(changes))  # a jumbled wire
    changes = changes[np.lexsort((np.arange(len(changes)), times))]
    edges = np.sort(rng.integers(0, len(changes), 300))
    return [changes[slice(*pair)] for pair in zip([0, *edges], [*edges, None], strict=True)]


def collector(path, source, clock, config=CONFIG):
    known = catalogue_of({"north": site([f"V{k}" for k in range(VALVES)])}, 1, PER_GROUP)
    sources = Sources([Part(None, source, tuple(range(VALVES)))])
    spool = Spool(path, 10_000_000)
    found = Collector(known, "north", config, sources, spool, clock)
    found.resume()
    return found, spool


async def hear(one, n, messages):
    """Have a collector take the next messages, as its supervisor does."""
    sources = one._sources
    changes = sources.parts[0].source.hand_out(messages, n)
    sources.taken[0] = sources.parts[0].source.mark
    await one.take(changes, np.arange(VALVES))


def arrived(topic):
    """Samples of each valve, from the blocks of each group by their numbers."""
    blocks = {}
    for group, data in topic:
        block = read_samples(data)
        assert block.group == group
        before = blocks.setdefault((group, block.number), data)
        assert before == data  # one that comes twice is the same
    numbers = {}
    for group, number in blocks:
        numbers.setdefault(group, set()).add(number)
    for group, of_group in numbers.items():
        assert of_group == set(range(1, len(of_group) + 1)), group
    found = {f"V{k}": [] for k in range(VALVES)}
    for _, data in sorted(blocks.items()):
        block = read_samples(data)
        for member, samples in block.samples.items():
            found[block.valves[member]].append(samples)
    return {name: Samples.concatenate(parts) for name, parts in found.items()}


async def live(path, source, messages, topic, rng, steps):
    """Collect and send for some steps, then end without a word."""
    clock = ManualClock(START)
    one, spool = collector(path, source, clock)
    try:
        for _ in range(steps):
            clock.advance(0.03)
            await hear(one, int(rng.integers(1, 6)), messages)
            await one.tick()
            if rng.random() < 0.7:
                await asyncio.sleep(0.002)
            taken = spool.take(int(rng.integers(1, 20_000)))
            topic += [(block.group, block.data) for block in taken]
            if rng.random() < 0.5:
                spool.note_sent([block.id for block in taken])
        if one._saving is not None:
            await one._saving
    finally:
        spool.close()


@pytest.mark.parametrize("seed", range(4))
async def test_a_collector_that_is_killed_loses_no_sample_and_doubles_none(
    tmp_path, truth, messages, seed
):
    rng, topic, path = np.random.default_rng(seed), [], tmp_path / "north.sqlite"
    lives = 0
    while True:
        source = Source()
        await live(path, source, messages, topic, rng, int(rng.integers(1, 30)))
        lives += 1
        if source.at == len(messages):
            break
    assert lives > 3
    source = Source()
    one, spool = collector(path, source, ManualClock(START))
    while source.at < len(messages):
        await hear(one, 10, messages)
    await one.finish()
    topic += [(block.group, block.data) for block in iter_all(spool)]
    spool.close()
    for k, (_, samples) in enumerate(sorted(arrived(topic).items())):
        for name, expected in vars(truth[k]).items():
            np.testing.assert_array_equal(getattr(samples, name), expected)


def iter_all(spool):
    while taken := spool.take(1_000_000):
        yield from taken


async def test_a_disk_that_takes_nothing_is_waited_for_and_nothing_is_lost(
    tmp_path, truth, messages, capsys
):
    structlog.reset_defaults()  # another test may have had errors logged alone
    source, clock = Source(), ManualClock(START)
    one, spool = collector(tmp_path / "north.sqlite", source, clock)
    spool._connection.execute("PRAGMA max_page_count = 12")
    while source.at < len(messages):
        await hear(one, 5, messages)
        clock.advance(0.2)
        await one._saving
    assert source.safe < len(messages)
    assert capsys.readouterr().out.count("samples not kept") == 1
    spool._connection.execute("PRAGMA max_page_count = 100000")
    await one.finish()
    assert source.safe == len(messages)
    found = arrived([(block.group, block.data) for block in iter_all(spool)])
    spool.close()
    assert [len(found[f"V{k}"]) for k in range(VALVES)] == [SAMPLES] * VALVES


async def test_no_block_is_larger_than_a_message_may_be(tmp_path, messages):
    config = CONFIG.model_copy(update={"topics": TopicsConfig(message_mb=0.1)})
    source, clock = Source(), ManualClock(START)
    one, spool = collector(tmp_path / "north.sqlite", source, clock, config)
    await hear(one, len(messages), messages)
    await one.finish()
    sizes = [len(block.data) for block in iter_all(spool)]
    spool.close()
    assert max(sizes) < 100_000
    assert len(sizes) == 3  # of three groups


async def test_what_is_under_way_of_other_valves_is_left_aside(tmp_path, messages, capsys):
    structlog.reset_defaults()  # another test may have had errors logged alone
    source = Source()
    one, spool = collector(tmp_path / "north.sqlite", source, ManualClock(START))
    await hear(one, 7, messages)
    await one.finish()
    spool.close()
    known = catalogue_of({"north": site([f"W{k}" for k in range(VALVES)])}, 1, PER_GROUP)
    with Spool(tmp_path / "north.sqlite", 1_000_000) as spool:
        sources = Sources([Part(None, Source(), tuple(range(VALVES)))])
        Collector(known, "north", CONFIG, sources, spool).resume()
    assert "not yet aligned are dropped" in capsys.readouterr().out


def test_of_several_sites_one_must_be_named():
    known = catalogue_of({"north": site(["V1"]), "south": site(["V2"])})
    with pytest.raises(ConfigurationError, match="several sites; name one as SITE: north, south"):
        site_of(known, None)
    with pytest.raises(ConfigurationError, match="no site 'east' in the catalogue"):
        site_of(known, "east")
    assert site_of(known, "south") == "south"
