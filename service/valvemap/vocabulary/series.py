"""The series of `/metrics`, one row a series: of valves, the service, the page and MQTT.

Each program's exposition, the documentation's table and the checks of the dashboards are made from
these rows. A new series is a row here, and the program that has it yields its points.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from valvemap.vocabulary.axis_quantities import AXIS_QUANTITIES
from valvemap.vocabulary.quantities import FRAME_QUANTITIES, Kind


@dataclass(frozen=True)
class Series:
    """One family of series.

    Attributes
    ----------
    name
        Without the suffix of a counter.
    sentence
        Its HELP.
    labels
        Names of its labels. Their values are configured names and fixed words, so that their
        number is bounded.
    is_count
        Whether it is a counter, else a gauge.
    """

    name: str
    sentence: str
    labels: tuple[str, ...] = ()
    is_count: bool = False

    @property
    def shown(self) -> str:
        """Name in the exposition.

        >>> Series("valvemap_samples", "Samples learnt.", is_count=True).shown
        'valvemap_samples_total'
        """
        return f"{self.name}_total" if self.is_count else self.name


class Point(NamedTuple):
    """A value of a series, with its labels' values in the order of their names."""

    series: Series
    value: float
    labels: tuple[str, ...] = ()


def counter(name: str, sentence: str, *labels: str) -> Series:
    """Return a series that only increases."""
    return Series(name, sentence, labels, is_count=True)


BUILD: Final = Series("valvemap_build_info", "Version of the program; always 1.", ("version",))

VALVE_SEVERITY: Final = Series(
    "valvemap_valve_severity",
    "Health of a valve: 0 good, 1 note, 2 warning, 3 alarm.",
    ("valve",),
)
FIRST_RMSE: Final = Series(
    "valvemap_residual_rmse_litres_per_minute",
    "Root mean square of the newest residuals of the valve's first estimator.",
    ("valve",),
)
SAMPLES: Final = counter(
    "valvemap_samples", "Samples that the valve's first estimator has learnt from.", "valve"
)
SILENT: Final = Series(
    "valvemap_silent_seconds", "Time since the newest sample was seen.", ("valve",)
)
SAMPLE_AGE: Final = Series(
    "valvemap_sample_age_seconds",
    "By how much the newest sample is behind the source's clock.",
    ("valve",),
)
PENDING: Final = Series(
    "valvemap_pending_samples", "Samples that wait for some of their signals.", ("valve",)
)
LAG: Final = Series(
    "valvemap_lag_seconds",
    "Estimated lag of the effect of U, or of the flow meter.",
    ("valve", "of"),
)
DIAGNOSTICS: Final = counter(
    "valvemap_diagnostics",
    "Samples of the valve that were aligned, late, lost or rejected.",
    "valve",
    "what",
)
ALARM_SEVERITY: Final = Series(
    "valvemap_alarm_severity",
    "Severity of an alarm, 1 to 1,000 (OPC UA Part 9); 0 if it only waits for an operator. "
    "Other alarms have no series.",
    ("source", "alarm"),
)
ALARM_WAITING: Final = Series(
    "valvemap_alarm_unacknowledged",
    "Whether an alarm is not acknowledged or not confirmed.",
    ("source", "alarm"),
)
QUANTITIES: Final[Mapping[str, Series]] = {
    quantity.name: Series(
        quantity.series, quantity.sentence, ("valve", "estimator"), quantity.kind is Kind.COUNT
    )
    for quantity in FRAME_QUANTITIES
    if quantity.series is not None
}
"""By name of the quantity."""

AXES: Final[Mapping[str, Series]] = {
    quantity.name: Series(quantity.series, quantity.sentence, ("axis",))
    for quantity in AXIS_QUANTITIES
    if quantity.series is not None
}
"""By name of the quantity of an axis."""

SOURCE: Final = counter(
    "valvemap_source", "Notifications and losses of the source since the start.", "what"
)
SERVICE_UP: Final = Series(
    "valvemap_service_up", "Whether the service answers this program, its client."
)
COMPILED: Final = Series(
    "valvemap_start_compiled_percent", "Share of the kernels compiled since the start."
)
CHECKPOINT_AGE: Final = Series(
    "valvemap_checkpoint_age_seconds", "Time since the last save of the states."
)
CHECKPOINT_FAILURES: Final = counter("valvemap_checkpoint_failures", "Failed saves of the states.")
CHECKPOINT_REFUSED: Final = counter(
    "valvemap_checkpoint_refused", "States rejected at the start of the service."
)
CHECKPOINT_BYTES: Final = Series("valvemap_checkpoint_bytes", "Size of the states on disk.")
SESSIONS: Final = Series("valvemap_sessions", "Sessions open at the service.")
SUBSCRIPTIONS: Final = Series("valvemap_subscriptions", "Subscriptions open at the service.")
REFUSED: Final = counter(
    "valvemap_refused", "Sessions and requests that the service's OPC UA server refused.", "what"
)

PAGE_VIEWERS: Final = Series("valvemap_page_viewers", "Open pages.")
PAGE_LOG_INS: Final = Series("valvemap_page_log_ins", "Users logged in on the page.")
PAGE_CONNECTIONS: Final = Series("valvemap_page_connections", "Connections to the page.")
PAGE_REFUSED: Final = counter(
    "valvemap_page_refused",
    "Requests and log-ins that the page refused, connections that it refused or ended.",
    "why",
)


BROKER_UP: Final = Series("valvemap_broker_up", "Whether the program reaches its broker.")

MQTT_WAITING: Final = Series("valvemap_mqtt_waiting_values", "Values that wait for the broker.")
MQTT_LIMIT: Final = Series(
    "valvemap_mqtt_limit_values", "Number of waiting values above which the oldest are dropped."
)
MQTT_LOST: Final = counter("valvemap_mqtt_lost_values", "Values dropped before they were sent.")
MQTT_OVERFLOWS: Final = counter(
    "valvemap_mqtt_overflows", "Values that the service lost in the queues of this client."
)
MQTT_REFUSED: Final = counter(
    "valvemap_mqtt_refused_packets", "Packets of the broker that were refused."
)
MQTT_CONNECTIONS: Final = counter(
    "valvemap_mqtt_connections", "Connections to the broker since the start."
)
MQTT_METRICS: Final = Series("valvemap_mqtt_metrics", "Metrics that the edge node publishes.")

EXPORTER_REFUSED: Final = counter(
    "valvemap_exporter_refused",
    "Requests that the exporter refused, and connections that it refused or ended.",
    "why",
)

OF_VALVES: Final[Sequence[Series]] = (
    ALARM_SEVERITY,
    ALARM_WAITING,
    *QUANTITIES.values(),
    DIAGNOSTICS,
)
OF_PAGE: Final[Sequence[Series]] = (
    BUILD,
    SERVICE_UP,
    *OF_VALVES,
    *AXES.values(),
    VALVE_SEVERITY,
    FIRST_RMSE,
    SAMPLES,
    SILENT,
    SAMPLE_AGE,
    PENDING,
    LAG,
    SOURCE,
    COMPILED,
    CHECKPOINT_AGE,
    CHECKPOINT_FAILURES,
    CHECKPOINT_REFUSED,
    CHECKPOINT_BYTES,
    SESSIONS,
    SUBSCRIPTIONS,
    REFUSED,
    PAGE_VIEWERS,
    PAGE_LOG_INS,
    PAGE_CONNECTIONS,
    PAGE_REFUSED,
)
OF_MQTT: Final[Sequence[Series]] = (
    BUILD,
    SERVICE_UP,
    BROKER_UP,
    MQTT_WAITING,
    MQTT_LIMIT,
    MQTT_LOST,
    MQTT_OVERFLOWS,
    MQTT_REFUSED,
    MQTT_CONNECTIONS,
    MQTT_METRICS,
    EXPORTER_REFUSED,
)
