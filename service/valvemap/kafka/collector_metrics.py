"""The metrics of a collector, read from its parts on request."""

from collections.abc import Iterator

from valvemap.kafka.collector import Collector
from valvemap.kafka.sending import Sender
from valvemap.kafka.spool import Spool
from valvemap.vocabulary import fleet_series, series
from valvemap.vocabulary.series import Point


def collector_points(collector: Collector, sender: Sender, spool: Spool) -> Iterator[Point]:
    """Yield all metrics; may be called in another thread."""
    yield Point(fleet_series.SPOOL_BLOCKS, spool.blocks)
    yield Point(fleet_series.SPOOL_BYTES, spool.bytes)
    yield Point(fleet_series.SPOOL_LIMIT, spool.most_bytes)
    yield Point(fleet_series.COLLECTOR_LOST, collector.given_up)
    yield Point(fleet_series.COLLECTOR_LEFT_OUT, collector.left_out)
    yield Point(fleet_series.COLLECTOR_SAMPLES, collector.packed)
    yield Point(fleet_series.COLLECTOR_UNSAVED, collector.unsaved_bytes)
    connected, others = collector.connected_valves
    yield Point(fleet_series.COLLECTOR_VALVES, connected, ("connected",))
    yield Point(fleet_series.COLLECTOR_VALVES, others, ("disconnected",))
    yield Point(fleet_series.COLLECTOR_IN_FLIGHT, sender.in_flight_bytes)
    yield Point(series.BROKER_UP, float(not sender.is_away))
    counters = collector.source_counters
    for what, count in (
        ("Notifications", counters.notifications),
        ("Overflows", counters.overflows),
        ("MissingMessages", counters.missing_messages),
        ("Undecodable", counters.undecodable),
        ("FromHistory", counters.from_history),
    ):
        yield Point(series.SOURCE, count, (what,))
