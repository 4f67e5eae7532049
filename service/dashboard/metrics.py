"""Figures for Prometheus, read from the service's nodes when they are asked for."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

from service.dashboard.observer import Link, Observer

if TYPE_CHECKING:
    from service.dashboard.guard import Guard
    from service.dashboard.log_ins import LogIns
    from service.dashboard.viewers import Viewers

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"


class Metrics:
    """All figures of one page process."""

    def __init__(
        self, observer: Observer, viewers: "Viewers", guard: "Guard", log_ins: "LogIns"
    ) -> None:
        self._observer = observer
        self._viewers = viewers
        self._guard = guard
        self._log_ins = log_ins
        self._registry = CollectorRegistry(auto_describe=False)
        self._registry.register(self)

    def exposition(self) -> bytes:
        """The text that Prometheus reads."""
        return generate_latest(self._registry)

    def collect(self) -> Iterator[Metric]:
        """Yield every figure; prometheus-client calls it."""
        up = self._observer.link is Link.UP
        yield GaugeMetricFamily(
            "valvemap_service_up", "Whether the service answers the page.", value=float(up)
        )
        if up:
            yield from self._of_valves()
        yield GaugeMetricFamily(
            "valvemap_page_viewers", "Open pages.", value=float(len(self._viewers))
        )
        yield GaugeMetricFamily(
            "valvemap_page_log_ins", "Users logged in on the page.", value=float(len(self._log_ins))
        )
        refused = CounterMetricFamily(
            "valvemap_page_refused", "Requests that the page refused.", labels=["why"]
        )
        for why in ("host", "origin", "rate", "size"):
            refused.add_metric([why], self._guard.refusals[why])
        refused.add_metric(["viewers"], self._viewers.refused)
        refused.add_metric(["senseless"], self._viewers.senseless)
        refused.add_metric(["log_in"], self._log_ins.failed)
        yield refused

    def _of_valves(self) -> Iterator[Metric]:
        valve = ["valve"]
        severity = GaugeMetricFamily(
            "valvemap_valve_severity",
            "How a valve stands: 0 good, 1 note, 2 warning, 3 alarm.",
            labels=valve,
        )
        rmse = GaugeMetricFamily(
            "valvemap_residual_rmse_litres_per_minute",
            "Root mean square of the newest residuals of the valve's first estimator.",
            labels=valve,
        )
        samples = CounterMetricFamily(
            "valvemap_samples", "Samples that it has learnt from.", labels=valve
        )
        silent = GaugeMetricFamily(
            "valvemap_silent_seconds", "Time since the newest sample was seen.", labels=valve
        )
        for number, row in self._observer.rows.items():
            name = [self._observer.valves[number].name]
            severity.add_metric(name, float(row.reason.severity))
            rmse.add_metric(name, row.rmse)
            samples.add_metric(name, row.samples)
            silent.add_metric(name, self._observer.silent_s(number))
        yield from (severity, rmse, samples, silent)
        dropped = CounterMetricFamily(
            "valvemap_diagnostics",
            "What became of the valve's data on their way into the model.",
            labels=["valve", "what"],
        )
        for (number, what), value in self._observer.counters.items():
            dropped.add_metric([self._observer.valves[number].name, what], value)
        yield dropped
