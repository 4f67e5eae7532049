"""The page of quantities and statuses, generated from the vocabulary's tables."""

from documentation.alarms import alarm_tables
from documentation.tables import table
from valvemap.vocabulary.dynamics import DynamicsStatus
from valvemap.vocabulary.feed_forward import FeedForwardStatus
from valvemap.vocabulary.findings import FindingCode
from valvemap.vocabulary.program_series import PROGRAMS
from valvemap.vocabulary.quantities import ESTIMATOR_QUANTITIES, Kind, Quantity
from valvemap.vocabulary.signals import SENSORS, Signal
from valvemap.vocabulary.statuses import (
    Adaptation,
    AxisStatus,
    Described,
    InverseStatus,
    LineEdge,
    Status,
)

_ENUMERATIONS: tuple[tuple[type[Described], str, str], ...] = (
    (Status, "Status", "`s=<Valve>.<Estimator>.Status`: the use of the newest sample."),
    (
        Adaptation,
        "Adaptation",
        "`s=<Valve>.<Estimator>.Adaptation`: the explanation of the residuals.",
    ),
    (
        InverseStatus,
        "RequiredUStatus",
        "`s=<Valve>.Inverse.RequiredUStatus`, and the status that `Invert` returns.",
    ),
    (
        LineEdge,
        "Edge",
        "`s=<Valve>.LineA.Inverse.Edge`: the edge of a line that passes a demanded flow.",
    ),
    (
        FeedForwardStatus,
        "FeedForwardStatus",
        "`s=<Valve>.Inverse.FeedForwardStatus`: whether RequiredU is written to the valve.",
    ),
    (
        AxisStatus,
        "AxisStatus",
        "Of `valvemap.model.axis_search.identify`: whether a cylinder's edges are identified.",
    ),
    (
        DynamicsStatus,
        "Dynamics.Status",
        "`s=<Valve>.Dynamics.Status`: how the dynamics of a valve stand.",
    ),
    (
        FindingCode,
        "FindingCodes",
        "`s=<Valve>.Diagnostics.FindingCodes`: the causes that explain a valve's samples.",
    ),
)


_SIGNALS = """\
A valve has these signals, in these units. Without its node or column, an optional signal is not a
number, which is no fault; a value outside of the plausible range is one, and the sample is
rejected."""

_INTRODUCTION = """\
Each estimator publishes these quantities of each valve as `s=<Valve>.<Estimator>.<name>`.
The series are those of `/metrics`, labelled by valve and estimator."""

_ALARMS = """\
`s=<Valve>.Alarms.<name>` of each valve and `s=Service.Alarms.<name>` of the service, see
[Alarms](../alarms.md)."""


_METRICS = """\
Series of `/metrics` for Prometheus, by the command that has them:
[Watch many valves in Grafana](../how-to/grafana.md)."""


def vocabulary_page() -> str:
    """Return the page."""
    parts = [
        "# Signals, quantities and statuses",
        _SIGNALS,
        table(["name", "unit", "need", "plausible", "meaning"], [_signal(s) for s in SENSORS]),
        _INTRODUCTION,
        table(
            ["name", "unit", "in Frame", "in history", "series", "meaning"],
            [_row(quantity) for quantity in ESTIMATOR_QUANTITIES],
        ),
    ]
    for statuses, title, where in _ENUMERATIONS:
        rows = [[str(int(s)), f"`{s.name}`", s.label, s.sentence] for s in statuses]
        parts += [f"## {title}", where, table(["value", "name", "on the page", "meaning"], rows)]
    parts += ["## Alarms", _ALARMS, alarm_tables()]
    parts += ["## Metrics", _METRICS, table(["series", "of", "labels", "meaning"], _metrics())]
    return "\n\n".join(parts) + "\n"


def _signal(signal: Signal) -> list[str]:
    low, high = signal.plausible
    return [
        f"`{signal.label}`",
        signal.unit,
        signal.need.value,
        f"{low:g} … {high:g}",
        f"{signal.sentence[0].upper()}{signal.sentence[1:]}.",
    ]


def _metrics() -> list[list[str]]:
    every = {one: None for of in PROGRAMS.values() for one in of}
    return [
        [
            f"`{one.shown}`",
            ", ".join(f"`{name}`" for name, of in PROGRAMS.items() if one in of),
            ", ".join(f"`{label}`" for label in one.labels),
            one.sentence,
        ]
        for one in every
    ]


def _row(quantity: Quantity) -> list[str]:
    series = quantity.series or ""
    if series and quantity.kind is Kind.COUNT:
        series += "_total"
    return [
        f"`{quantity.name}`",
        quantity.unit or "",
        "yes" if quantity.in_frame else "",
        "yes" if quantity.in_history else "",
        f"`{series}`" if series else "",
        quantity.sentence,
    ]
