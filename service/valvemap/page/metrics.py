"""Prometheus metrics, read from the service's nodes on request."""

import math
from collections.abc import Iterator
from importlib.metadata import version
from typing import TYPE_CHECKING

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily, Metric

from valvemap.page.door import REASONS
from valvemap.page.observer import Link, Observer
from valvemap.vocabulary.quantities import FRAME_QUANTITIES, Kind

if TYPE_CHECKING:
    from valvemap.page.door import Door
    from valvemap.page.guard import Guard
    from valvemap.page.log_ins import LogIns
    from valvemap.page.viewers import Viewers

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"


class Metrics:
    """All metrics of one page process."""

    def __init__(
        self,
        observer: Observer,
        viewers: "Viewers",
        guard: "Guard",
        log_ins: "LogIns",
        door: "Door",
    ) -> None:
        self._observer = observer
        self._viewers = viewers
        self._guard = guard
        self._log_ins = log_ins
        self._door = door
        self._registry = CollectorRegistry(auto_describe=False)
        self._registry.register(self)

    def exposition(self) -> bytes:
        """Return the metrics in Prometheus text format."""
        return generate_latest(self._registry)

    def collect(self) -> Iterator[Metric]:
        """Yield all metrics; called by prometheus-client."""
        up = self._observer.link is Link.UP
        yield GaugeMetricFamily(
            "valvemap_service_up", "Whether the service answers the page.", value=float(up)
        )
        build = InfoMetricFamily("valvemap_build", "Version of the page's program.")
        build.add_metric([], {"version": version("valvemap")})
        yield build
        if up:
            yield from self._of_valves()
            yield from self._of_alarms()
            yield from self._of_service()
        yield GaugeMetricFamily(
            "valvemap_page_viewers", "Open pages.", value=float(len(self._viewers))
        )
        yield GaugeMetricFamily(
            "valvemap_page_log_ins", "Users logged in on the page.", value=float(len(self._log_ins))
        )
        yield GaugeMetricFamily(
            "valvemap_page_connections", "Connections to the page.", value=float(len(self._door))
        )
        refused = CounterMetricFamily(
            "valvemap_page_refused",
            "Requests that the page refused, and connections that it refused or ended.",
            labels=["why"],
        )
        for why in ("host", "origin", "rate", "size"):
            refused.add_metric([why], self._guard.refusals[why])
        for why in REASONS:
            refused.add_metric([why], self._door.refusals[why])
        refused.add_metric(["viewers"], self._viewers.refused)
        refused.add_metric(["senseless"], self._viewers.senseless)
        refused.add_metric(["log_in"], self._log_ins.failed)
        refused.add_metric(["tries"], self._log_ins.refused)
        yield refused

    def _of_valves(self) -> Iterator[Metric]:
        valve = ["valve"]
        severity = GaugeMetricFamily(
            "valvemap_valve_severity",
            "Health of a valve: 0 good, 1 note, 2 warning, 3 alarm.",
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
        yield from self._of_estimators()
        yield from self._of_diagnostics()

    def _of_alarms(self) -> Iterator[Metric]:
        """Yield the alarms that are active or wait for an operator; the others have no series."""
        labels = ["source", "alarm"]
        severity = GaugeMetricFamily(
            "valvemap_alarm_severity",
            "Severity of an alarm, 1 to 1,000 (OPC UA Part 9); 0 if it only waits for an operator.",
            labels=labels,
        )
        waiting = GaugeMetricFamily(
            "valvemap_alarm_unacknowledged",
            "Whether an alarm is not acknowledged or not confirmed.",
            labels=labels,
        )
        for (source, name), change in self._observer.alarms.present.items():
            severity.add_metric([source, name], float(change.severity if change.active else 0))
            waiting.add_metric([source, name], float(not (change.acked and change.confirmed)))
        yield from (severity, waiting)

    def _of_estimators(self) -> Iterator[Metric]:
        """Yield the quantities of the frame, by valve and estimator."""
        for quantity in FRAME_QUANTITIES:
            if quantity.series is None:
                continue
            family = CounterMetricFamily if quantity.kind is Kind.COUNT else GaugeMetricFamily
            series = family(quantity.series, quantity.sentence, labels=["valve", "estimator"])
            for number, columns in self._observer.frames.items():
                valve = self._observer.valves[number]
                for estimator in valve.estimators:
                    value = columns.get(f"{estimator}.{quantity.name}", math.nan)
                    if not math.isnan(value):
                        series.add_metric([valve.name, estimator], value)
            yield series

    def _of_diagnostics(self) -> Iterator[Metric]:
        """Yield the valves' data counters and ages."""
        gauges = {
            name: GaugeMetricFamily(figure, what, labels=["valve"])
            for name, (figure, what) in _DIAGNOSTICS.items()
        }
        counts = CounterMetricFamily(
            "valvemap_diagnostics",
            "What became of the valve's data on their way into the model.",
            labels=["valve", "what"],
        )
        lags = GaugeMetricFamily(
            "valvemap_lag_seconds",
            "Lag of U's effect, or of the flow meter, as found.",
            labels=["valve", "of"],
        )
        for (valve, name), value in self._observer.figures.valves.items():
            if name in gauges:
                gauges[name].add_metric([valve], value)
            elif name.startswith("Lag"):
                lags.add_metric([valve, name.removeprefix("Lag")], value)
            else:
                counts.add_metric([valve, name], value)
        yield from (*gauges.values(), lags, counts)

    def _of_service(self) -> Iterator[Metric]:
        """Yield checkpoint state, lost data, sessions and refusals of the service."""
        of_service, of_server = self._observer.figures.service, self._observer.figures.server
        for name, (family, figure, what) in _SERVICE.items():
            if name in of_service:
                yield family(figure, what, value=of_service[name])
        source = CounterMetricFamily(
            "valvemap_source",
            "Changes and losses of the source since the service started.",
            labels=["what"],
        )
        for name, value in of_service.items():
            part, _, what = name.partition(".")
            if part == "Source":
                source.add_metric([what], value)
        yield source
        for name, (figure, what) in _OPEN.items():
            if name in of_server:
                yield GaugeMetricFamily(figure, what, value=of_server[name])
        refused = CounterMetricFamily(
            "valvemap_refused", "What the service's OPC UA server refused.", labels=["what"]
        )
        for name, what in _REFUSED.items():
            if name in of_server:
                refused.add_metric([what], of_server[name])
        yield refused


_DIAGNOSTICS = {
    "SampleAge": (
        "valvemap_sample_age_seconds",
        "By how much the newest sample is behind the source's clock.",
    ),
    "Pending": ("valvemap_pending_samples", "Samples that wait for signals of theirs."),
}
_SERVICE: dict[str, tuple[type[CounterMetricFamily | GaugeMetricFamily], str, str]] = {
    "Start.Compiled": (
        GaugeMetricFamily,
        "valvemap_start_compiled_percent",
        "Share of the kernels compiled since the start.",
    ),
    "Checkpoint.Age": (
        GaugeMetricFamily,
        "valvemap_checkpoint_age_seconds",
        "Time since the last save of the states.",
    ),
    "Checkpoint.Failures": (
        CounterMetricFamily,
        "valvemap_checkpoint_failures",
        "How often states could not be kept.",
    ),
    "Checkpoint.Refused": (
        CounterMetricFamily,
        "valvemap_checkpoint_refused",
        "States found at the start that could not be used.",
    ),
    "Checkpoint.Size": (
        GaugeMetricFamily,
        "valvemap_checkpoint_bytes",
        "What the states take on disk.",
    ),
}
_OPEN = {
    "CurrentSessionCount": ("valvemap_sessions", "Sessions open at the service."),
    "CurrentSubscriptionCount": ("valvemap_subscriptions", "Subscriptions open at the service."),
}
_REFUSED = {
    "RejectedSessionCount": "sessions",
    "SecurityRejectedSessionCount": "sessions for security",
    "RejectedRequestsCount": "requests",
    "SecurityRejectedRequestsCount": "requests for security",
}
