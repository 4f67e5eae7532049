"""A collector's metrics: its spool, its losses, its sources."""

import pytest

pytest.importorskip("confluent_kafka")

from support.exposition import names, promtool_accepts, value
from support.fleet import site
from support.plant import as_changes, plant
from valvemap.clock import ManualClock
from valvemap.kafka.catalogue import catalogue_of
from valvemap.kafka.collector import Collector
from valvemap.kafka.collector_metrics import collector_points
from valvemap.kafka.sending import Sender
from valvemap.kafka.settings import CatalogueConfig, FleetConfig
from valvemap.kafka.spool import Spool
from valvemap.page.exposition import exposition
from valvemap.pipeline.source_ports import SourceCounters
from valvemap.runtime.sources import Part, Sources
from valvemap.vocabulary.fleet_series import OF_COLLECTOR

CONFIG = FleetConfig(catalogue=CatalogueConfig(valves_per_group=2))


class Source:
    """A source without a network."""

    clock_offset_s = 0.0
    counters = SourceCounters(notifications=9, overflows=2)

    def hold_back(self):
        pass


@pytest.fixture
def parts(tmp_path):
    known = catalogue_of({"north": site(["V0", "V1"])}, 1, 2)
    sources = Sources([Part(None, Source(), (0, 1))])
    with Spool(tmp_path / "north.sqlite", 2_000) as spool:
        collector = Collector(known, "north", CONFIG, sources, spool, ManualClock())
        collector.resume()
        yield collector, Sender(CONFIG, spool, lambda: None), spool


def text_of(parts):
    return exposition(collector_points(*parts)).decode()


async def test_what_is_collected_kept_and_lost_is_shown(parts):
    collector, _, spool = parts
    text = text_of(parts)
    assert value(text, "valvemap_collector_valves", state="connected") == 0
    await collector.take(as_changes(plant(100)))
    await collector.finish()
    text = text_of(parts)
    assert value(text, "valvemap_collector_samples_total") == 100
    assert value(text, "valvemap_spool_bytes") == spool.bytes
    assert value(text, "valvemap_spool_limit_bytes") == 2_000
    assert value(text, "valvemap_collector_lost_samples_total") == 100  # the block is larger
    assert value(text, "valvemap_collector_valves", state="connected") == 2
    assert value(text, "valvemap_source_total", what="Overflows") == 2
    await collector.lost(None)
    assert value(text_of(parts), "valvemap_collector_valves", state="disconnected") == 2


async def test_every_series_is_there_and_promtool_accepts_them(parts):
    text = text_of(parts)
    apart = {"valvemap_build_info", "valvemap_exporter_refused_total"}  # the exporter's own
    assert names(text) == {one.shown for one in OF_COLLECTOR} - apart
    promtool_accepts(text)
