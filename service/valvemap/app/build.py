"""From the configuration's words to the objects that do the work."""

from collections.abc import Awaitable, Callable, Hashable, Iterable
from dataclasses import replace
from typing import Any, TypeVar

from guarded_opcua import (
    Limits,
    OwnCertificate,
    Pki,
    ServerSettings,
    ensure_certificate,
    load_certificate,
)
from valvemap.app.identities import APPLICATION_NAME, APPLICATION_URI, PAGE_URI, PRODUCT, load_users
from valvemap.config.alarms import AlarmsConfig
from valvemap.config.estimators import build_estimator
from valvemap.config.models import Config, GateConfig, SourceConfig, ValveConfig
from valvemap.config.secret_files import read_secret
from valvemap.config.signals import SignalsConfig
from valvemap.errors import ConfigurationError
from valvemap.model.estimator import Estimator
from valvemap.model.sensor_accuracy import SensorAccuracy
from valvemap.opcua_source.client import OpcUaSource, Security, SourceSettings, ValveNodes
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.data_changes import Signal
from valvemap.pipeline.feedforward import Fallback, FeedForward
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.quality_gate import SENSORS, QualityGate
from valvemap.pipeline.timing import Timing, TimingSettings
from valvemap.pipeline.units import MEASURED, QUANTITY_OF, READ, Measure
from valvemap.pipeline.valve_state import ValvePlan
from valvemap.runtime.live import LiveSettings
from valvemap.runtime.sources import Part, Sources
from valvemap.runtime.state_keeper import KEPT_PER_S
from valvemap.runtime.supervisor import SupervisorSettings
from valvemap.storage.history import HistoryFile
from valvemap.storage.layout import Layout, ValveLayout

R = TypeVar("R")

_AXIS_POINTS = 21
_HEARTBEAT_TICK_S = 0.1  # at least five heartbeats in a second


def build_identification(config: Config) -> Identification:
    """All valves with their estimators, before the first sample."""
    interval_s = max(config.state.checkpoint_interval_s, len(config.valves) / KEPT_PER_S)
    return Identification(
        build_plans(config),
        build_alignment(config),
        build_timing(config),
        config.alarms.rules(interval_s),
    )


def build_alignment(config: Config) -> Alignment:
    """How the signals of all valves find together."""
    signals = {"U": Signal.U, "p1": Signal.P1, "p2": Signal.P2, "Q": Signal.Q, "T": Signal.T}
    given, reorder_ns = config.alignment, round(config.alignment.reorder_ms * 1e6)
    settings = AlignmentSettings(
        tolerance_ns=round(given.tolerance_ms * 1e6),
        max_wait_ns=round(given.max_wait_s * 1e9),
        max_pending=given.max_pending,
        reorder_ns=reorder_ns,
        reorder_by_time_ns=reorder_ns if "reorder_ms" in given.model_fields_set else 0,
        hold_ns={signals[name]: round(s * 1e9) for name, s in given.hold_s.items()},
    )
    return Alignment(
        settings,
        has_T=tuple(valve.nodes.T is not None for valve in config.valves),
        has_sequence=tuple(valve.nodes.sequence is not None for valve in config.valves),
    )


def build_timing(config: Config) -> Timing | None:
    """How it is found in what way signals come; None where the configuration says it."""
    given = config.alignment
    if not given.finds_timing:
        return None
    slowest_ms = max(source.publishing_interval_ms for source in config.all_sources)
    horizon_s = max(given.reorder_ms, 2.0 * slowest_ms) * 1e-3
    return Timing(
        TimingSettings(round(horizon_s * 1e9), round(given.max_wait_s * 1e9)),
        has_T=[valve.nodes.T is not None for valve in config.valves],
        has_sequence=[valve.nodes.sequence is not None for valve in config.valves],
    )


def build_plans(config: Config) -> list[ValvePlan]:
    """What is done with each valve's samples; what is configured alike is made once, and shared."""
    shared = _Shared()
    return [_plan(valve, shared) for valve in config.valves]


def build_sources(config: Config, ready: Callable[[], Awaitable[None]] | None = None) -> Sources:
    """The clients of all source servers; they take samples once all is ``ready``."""
    if not config.sources:
        every = tuple(range(len(config.valves)))
        return Sources([Part(None, build_source(config, ready), every)])
    parts = []
    for source in config.sources:
        own = [n for n, valve in enumerate(config.valves) if valve.source == source.name]
        client = build_source(config.only(source.name), ready)
        parts.append(Part(source.name, client, tuple(own)))
    return Sources(parts)


def build_source(config: Config, ready: Callable[[], Awaitable[None]] | None = None) -> OpcUaSource:
    """The client of the source server; it takes samples once it is ``ready``.

    Raises
    ------
    ConfigurationError
        if there are several.
    """
    if config.sources:
        names = ", ".join(source.name for source in config.sources)
        raise ConfigurationError(f"there are several sources: --source NAME says which: {names}")
    own = None if config.source.security == "None" else own_certificate(config)
    settings = SourceSettings(
        url=config.source.url,
        security=Security(config.source.security),
        pki=None if own is None else Pki(config.security.pki),
        own=own,
        user=config.source.user,
        password=_password(config.source),
        check_host_name=config.source.check_host_name,
        require_crl=config.security.require_crl,
        application_uri=None if own is not None else APPLICATION_URI,
        publishing_interval_ms=config.source.publishing_interval_ms,
        queue_size=config.source.queue_size,
        history_s=config.source.history_s,
        warm_start_s=config.source.warm_start_s,
        timeout_s=config.source.timeout_s,
    )
    nodes = [
        ValveNodes(
            valve=valve.name,
            **valve.nodes.model_dump(),
            measures=_measures(valve, QUANTITY_OF),
            insist=valve.insist,
        )
        for valve in config.valves
    ]
    return OpcUaSource(settings, nodes, ready=ready)


def build_layout(config: Config) -> Layout:
    """Where recordings hold the valves' signals."""
    return Layout(
        valves=tuple(
            ValveLayout(valve.name, _measures(valve, MEASURED)) for valve in config.valves
        ),
        time=config.recording.time,
        valve=config.recording.valve,
        quality=config.recording.quality,
    )


def build_server_settings(config: Config) -> ServerSettings:
    """Identity, endpoint and users of the results server."""
    return ServerSettings(
        url=config.server.url,
        application_uri=APPLICATION_URI,
        application_name=APPLICATION_NAME,
        namespace_uri=APPLICATION_URI,
        pki=Pki(config.security.pki),
        require_crl=config.security.require_crl,
        users=load_users(config.security.users),
        anonymous_observer=config.server.anonymous_observer,
        host_names=config.server.host_names,
        gateways=frozenset({PAGE_URI}),
        limits=Limits(publishing_interval_ms=config.server.min_publishing_interval_ms),
        product=PRODUCT,
    )


def build_history(config: Config) -> HistoryFile | None:
    """The file of what signals and results have been, if there is to be one."""
    given = config.history
    if given.file is None:
        return None
    return HistoryFile(given.file, given.keep_days * 86_400.0, given.most_mb * 1_000_000)


def build_live_settings(config: Config, certificate: OwnCertificate | None) -> LiveSettings:
    """When results are stale, when states are kept, until when the certificate is valid."""
    until_ns = 0
    if certificate is not None:
        until = load_certificate(certificate.certificate).not_valid_after_utc
        until_ns = int(until.timestamp()) * 1_000_000_000
    return LiveSettings(
        certificate_until_ns=until_ns,
        stale_after_s=config.alignment.stale_after_s,
        reorder_s=config.alignment.reorder_ms * 1e-3,
        checkpoint_interval_s=config.state.checkpoint_interval_s,
    )


def build_supervisor_settings(config: Config) -> SupervisorSettings:
    """How long the start may take, how often the service looks at its clock."""
    feeds_forward = any(valve.nodes.required_U is not None for valve in config.valves)
    settings = SupervisorSettings(startup_timeout_s=config.source.startup_timeout_s)
    if config.sources:  # one that is away holds up none of the others
        settings = replace(settings, startup_timeout_s=0.0)
    return replace(settings, tick_s=_HEARTBEAT_TICK_S) if feeds_forward else settings


def own_certificate(config: Config) -> OwnCertificate:
    """The service's certificate, made at the first start; as a client and as a server."""
    names = config.server.host_names or ("localhost", "127.0.0.1")
    file_name = APPLICATION_NAME.replace(" ", "-")
    return ensure_certificate(Pki(config.security.pki), APPLICATION_URI, names, file_name)


def _measures(valve: ValveConfig, names: Iterable[str]) -> dict[str, Measure]:
    return {name: getattr(valve.signals, name).measure(name) for name in names}


class _Shared:
    """Makes each thing once, from parts of the configuration that are hashable."""

    def __init__(self) -> None:
        self._known: dict[object, Any] = {}

    def __call__(self, make: Callable[..., R], *of: Hashable) -> R:
        if (make, of) not in self._known:
            self._known[make, of] = make(*of)
        found: R = self._known[make, of]
        return found


def _plan(valve: ValveConfig, shared: _Shared) -> ValvePlan:
    ranges = valve.U_range_percent, valve.dp_range_bar, valve.Q_range_l_min
    estimators: dict[str, Estimator[Any]] = {
        e.name: shared(build_estimator, e, *ranges) for e in valve.estimators
    }
    return ValvePlan(
        name=valve.name,
        gate=shared(_gate, valve.gate),
        estimators=estimators,
        inverse=valve.inverse or ("Auto" if "Auto" in estimators else valve.estimators[0].name),
        U_range=valve.U_range_percent,
        map_Q=shared(_axis, *valve.Q_range_l_min),
        map_dp=shared(_axis, *valve.dp_range_bar),
        feed_forward=_feed_forward(valve),
        insist=valve.insist,
        alarms=shared(AlarmsConfig.rules, valve.alarms),
        nameplate=valve.identification.nameplate(valve.name),
        nodes={name: f"{name} ({valve.nodes.of(name)})" for name in READ if valve.nodes.of(name)},
        accuracy=shared(_accuracy, valve.signals),
    )


def _gate(configured: GateConfig) -> QualityGate:
    return QualityGate(
        limits={s: getattr(configured, name).limits(s) for s, name in _GATES.items()},
        use_uncertain=configured.use_uncertain,
    )


def _accuracy(signals: SignalsConfig) -> SensorAccuracy:
    return SensorAccuracy(**{name: getattr(signals, name).error_limit(name) for name in MEASURED})


def _feed_forward(valve: ValveConfig) -> FeedForward | None:
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
    )


_GATES = dict(zip(SENSORS, MEASURED, strict=True))


def _axis(low: float, high: float) -> tuple[float, ...]:
    step = (high - low) / (_AXIS_POINTS - 1)
    return tuple(low + k * step for k in range(_AXIS_POINTS))


def _password(source: SourceConfig) -> str | None:
    if source.password is not None:
        return source.password.get_secret_value()
    if source.password_file is None:
        return None
    return read_secret(source.password_file)
