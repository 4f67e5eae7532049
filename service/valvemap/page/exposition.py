"""Points of series in Prometheus' text format."""

import math
from collections.abc import Iterable, Iterator
from importlib.metadata import version

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

from valvemap.page import door, guard
from valvemap.vocabulary.series import BUILD, Point, Series

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"


def exposition(points: Iterable[Point]) -> bytes:
    """Return the points in Prometheus' text format; those that are NaN are left out.

    >>> print(exposition([Point(BUILD, 1.0, ("1.2",))]).decode(), end="")
    # HELP valvemap_build_info Version of the program; always 1.
    # TYPE valvemap_build_info gauge
    valvemap_build_info{version="1.2"} 1.0
    """
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_Collected(points))
    return generate_latest(registry)


def build_point() -> Point:
    """Return the version of this program."""
    return Point(BUILD, 1.0, (version("valvemap"),))


def refusals(at_guard: guard.Guard, at_door: door.Door) -> dict[str, int]:
    """Return the refusals of a server by reason, also those that are 0."""
    return {
        **{why: at_guard.refusals[why] for why in guard.REASONS},
        **{why: at_door.refusals[why] for why in door.REASONS},
    }


class _Collected:
    """The points, as prometheus-client asks for them."""

    def __init__(self, points: Iterable[Point]) -> None:
        self._points = points

    def collect(self) -> Iterator[Metric]:
        families: dict[Series, CounterMetricFamily | GaugeMetricFamily] = {}
        for series, value, labels in self._points:
            if series not in families:
                family = CounterMetricFamily if series.is_count else GaugeMetricFamily
                families[series] = family(series.name, series.sentence, labels=series.labels)
            if not math.isnan(value):
                families[series].add_metric(labels, value)
        yield from families.values()
