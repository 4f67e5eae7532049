"""Builds plans, alignment and layouts from the configuration, without importing a server."""

from collections.abc import Callable, Collection, Hashable, Iterable, Mapping
from dataclasses import fields, replace
from typing import Any, Final, TypeVar

from valvemap.config.alarms import AlarmsConfig
from valvemap.config.axes import AxisConfig
from valvemap.config.estimators import build_estimator
from valvemap.config.meters import meters_of
from valvemap.config.models import Config
from valvemap.config.samples import GateConfig
from valvemap.config.signals import SignalConfig, SignalsConfig
from valvemap.config.valve_parts import EdgeConfig, LineConfig
from valvemap.config.valves import RECOMMENDED, NodesConfig, ValveConfig
from valvemap.model.capabilities import Forgetful
from valvemap.model.estimator import Estimator
from valvemap.model.leakage import Leakage
from valvemap.model.sensor_accuracy import SensorAccuracy
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.edges import LEAK, Part
from valvemap.pipeline.feedforward import Fallback, FeedForward
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.meaning import Meaning, SignalMeaning
from valvemap.pipeline.quality_gate import QualityGate
from valvemap.pipeline.timing import Timing, TimingSettings
from valvemap.pipeline.units import QUANTITY_OF, Measure
from valvemap.pipeline.valve_state import ValvePlan, runs_interpreted
from valvemap.runtime.state_keeper import KEPT_PER_S
from valvemap.storage.layout import Layout, ValveLayout
from valvemap.vocabulary.signals import MEASURED, OPTIONAL, READ, SENSORS, Signal

R = TypeVar("R")

_AXIS_POINTS = 21
PREFERRED: Final = "Auto"


def build_identification(config: Config, *, waits: Collection[str] | None = None) -> Identification:
    """Return all valves with their estimators, before the first sample.

    With ``waits``, a preview in which the estimators named there do not run: `Identification`.
    """
    interval_s = max(config.state.checkpoint_interval_s, len(config.valves) / KEPT_PER_S)
    return Identification(
        build_plans(config),
        build_alignment(config),
        build_timing(config),
        config.alarms.rules(interval_s),
        waits,
    )


def build_preview(config: Config) -> Identification:
    """As `build_identification`, for interpreted kernels: estimators too slow for these wait."""
    estimators = [pair for plan in build_plans(config) for pair in plan.estimators.items()]
    return build_identification(
        config, waits={name for name, estimator in estimators if not runs_interpreted(estimator)}
    )


def build_alignment(config: Config) -> Alignment:
    """Return the alignment of the signals of all valves."""
    has_sequence = tuple(valve.nodes.sequence is not None for valve in config.valves)
    return alignment_of(config, _optional(config), has_sequence)


def alignment_of(
    config: Config, optional: tuple[tuple[str, ...], ...], has_sequence: tuple[bool, ...]
) -> Alignment:
    """Return the alignment of rows of signals with these optional ones."""
    given, reorder_ns = config.alignment, round(config.alignment.reorder_ms * 1e6)
    settings = AlignmentSettings(
        tolerance_ns=round(given.tolerance_ms * 1e6),
        max_wait_ns=round(given.max_wait_s * 1e9),
        max_pending=given.max_pending,
        reorder_ns=reorder_ns,
        reorder_by_time_ns=reorder_ns if "reorder_ms" in given.model_fields_set else 0,
        hold_ns={Signal.of(name): round(s * 1e9) for name, s in given.hold_s.items()},
    )
    return Alignment(settings, optional=optional, has_sequence=has_sequence)


def _optional(config: Config) -> tuple[tuple[str, ...], ...]:
    """Return the names of each valve's optional signals."""
    return tuple(
        tuple(name for name in OPTIONAL if valve.nodes.of(name)) for valve in config.valves
    )


def build_timing(config: Config) -> Timing | None:
    """Return the detection of the signals' timing; None if the timing is configured."""
    has_sequence = tuple(valve.nodes.sequence is not None for valve in config.valves)
    return timing_of(config, _optional(config), has_sequence)


def timing_of(
    config: Config,
    optional: tuple[tuple[str, ...], ...],
    has_sequence: tuple[bool, ...],
) -> Timing | None:
    """Return the detection of the timing of rows of signals; None if it is configured."""
    given = config.alignment
    if not given.finds_timing:
        return None
    slowest_ms = max(source.publishing_interval_ms for source in config.all_sources)
    horizon_s = max(given.reorder_ms, 2.0 * slowest_ms) * 1e-3
    return Timing(
        TimingSettings(round(horizon_s * 1e9), round(given.max_wait_s * 1e9)),
        optional=optional,
        has_sequence=has_sequence,
    )


def build_plans(config: Config) -> list[ValvePlan]:
    """Return a plan per valve; objects of equal configuration are created once and shared."""
    shared, meters = _Shared(), meters_of(config.valves)
    plans = [_plan(config, valve, shared) for valve in config.valves]
    return [replace(plan, meter=meters.get(plan.name, "")) for plan in plans]


def meaning_of(
    config: Config, valve: ValveConfig, estimators: Mapping[str, Estimator[Any]]
) -> Meaning:
    """Return what a valve's signals mean: it is stored with the states learnt from them."""
    lam = {name: one.lam for name, one in estimators.items() if isinstance(one, Forgetful)}
    signals: dict[str, SignalMeaning] = {}
    for name in READ:
        source = valve.nodes.source_of(name)
        node = valve.nodes.of(source)
        if node is not None and name in MEASURED:
            given: SignalConfig = getattr(valve.signals, source)
            scaling, limit = given.measure(source).scaling(source), given.error_limit(source)
            signals[name] = SignalMeaning(
                node, given.in_words(QUANTITY_OF[source]), scaling.gain, scaling.offset, limit
            )
        elif node is not None:
            signals[name] = SignalMeaning(node)
    return Meaning(config.source_of(valve).url, signals, lam)


def build_layout(config: Config) -> Layout:
    """Return the columns of the valves' signals in recordings."""
    return Layout(
        valves=tuple(
            ValveLayout(
                valve.name,
                _columns(valve),
                drop=_has_drop_column(valve),
                recorded=_part(valve) is not None,
            )
            for valve in config.valves
        ),
        time=config.recording.time,
        valve=config.recording.valve,
        quality=config.recording.quality,
    )


def _columns(valve: ValveConfig) -> dict[str, Measure]:
    """Return unit and column of a valve's signals in recordings; p1 may be a pressure drop."""
    found = measures(valve, MEASURED)
    return found | {"p1": valve.signals.dp.measure("dp")} if _has_drop_column(valve) else found


def _has_drop_column(valve: ValveConfig) -> bool:
    return valve.nodes.dp is not None and valve.signals.dp.column is not None


def measures(valve: ValveConfig, names: Iterable[str]) -> dict[str, Measure]:
    """Return unit and scaling of the given signals of a valve, as configured."""
    return {name: getattr(valve.signals, name).measure(name) for name in names}


class _Shared:
    """Creates one object per function and (hashable) arguments, and caches it."""

    def __init__(self) -> None:
        self._known: dict[object, Any] = {}

    def __call__(self, make: Callable[..., R], *of: Hashable) -> R:
        if (make, of) not in self._known:
            self._known[make, of] = make(*of)
        found: R = self._known[make, of]
        return found


def _plan(config: Config, valve: ValveConfig, shared: _Shared) -> ValvePlan:
    ranges = valve.U_range_percent, valve.dp_range_bar, valve.Q_range_l_min
    estimators: dict[str, Estimator[Any]] = {
        e.name: shared(build_estimator, e, *ranges) for e in valve.estimators
    }
    if isinstance(valve, LineConfig):
        estimators = {LEAK: shared(Leakage, valve.closed_percent, valve.U_range_percent)}
    follows = valve.inverse in (None, RECOMMENDED) and RECOMMENDED not in estimators
    return ValvePlan(
        name=valve.name,
        gate=shared(_gate, valve.gate),
        estimators=estimators,
        inverse=_at_first(estimators) if follows else str(valve.inverse),
        follows=follows,
        U_range=valve.U_range_percent,
        map_Q=shared(_axis, *valve.Q_range_l_min),
        map_dp=shared(_axis, *valve.dp_range_bar),
        feed_forward=feed_forward_of(valve),
        insist=valve.insist or isinstance(valve, LineConfig),  # p1 - p2 has either sign there
        alarms=shared(AlarmsConfig.rules, valve.alarms),
        nameplate=valve.identification.nameplate(valve.name),
        nodes=_labels(valve.nodes),
        accuracy=shared(_accuracy, valve.signals, valve.nodes.dp is not None),
        meaning=meaning_of(config, valve, estimators),
        part=_part(valve),
        is_driven=valve.nodes.required_U is not None and valve.nodes.heartbeat is not None,
    )


def _part(valve: ValveConfig) -> Part | None:
    match valve:
        case EdgeConfig():
            return Part(valve.valve, valve.edge.line, valve.edge)
        case LineConfig():
            return Part(valve.valve, valve.line)
        case _:
            return None


def _at_first(estimators: Mapping[str, Estimator[Any]]) -> str:
    """Name of the estimator whose map is inverted before another is recommended."""
    return PREFERRED if PREFERRED in estimators else next(iter(estimators))


def _gate(configured: GateConfig) -> QualityGate:
    return QualityGate(
        limits={s: getattr(configured, s.label).limits(s) for s in SENSORS},
        use_uncertain=configured.use_uncertain,
    )


def _labels(nodes: NodesConfig) -> dict[str, str]:
    """Return each signal's name and node, for messages."""
    sources = {name: nodes.source_of(name) for name in READ}
    return {
        name: f"{source} ({nodes.of(source)})"
        for name, source in sources.items()
        if nodes.of(source)
    }


def _accuracy(signals: SignalsConfig, has_dp: bool) -> SensorAccuracy:  # noqa: FBT001 - hashed
    stated = [field.name for field in fields(SensorAccuracy)]
    limits = {name: getattr(signals, name).error_limit(name) for name in stated}
    if has_dp:
        limits |= {"p1": signals.dp.error_limit("dp"), "p2": 0.0}
    return SensorAccuracy(**limits)


def feed_forward_of(valve: ValveConfig | AxisConfig) -> FeedForward | None:
    """Return the settings of feed-forward; None: there is no node to write to."""
    if valve.nodes.required_U is None:
        return None
    given = valve.feed_forward
    return FeedForward(
        U_range=given.range_percent,
        slew_percent_per_s=given.slew_percent_per_s,
        fallback=Fallback(given.fallback),
        fallback_U=given.fallback_percent,
        max_age_s=given.max_age_s,
        max_width_percent=given.max_width_percent,
        has_heartbeat=valve.nodes.heartbeat is not None,
        leads=given.lead,
    )


def _axis(low: float, high: float) -> tuple[float, ...]:
    step = (high - low) / (_AXIS_POINTS - 1)
    return tuple(low + k * step for k in range(_AXIS_POINTS))
