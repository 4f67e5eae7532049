"""Builds source clients, results server settings and stores from the configuration."""

from collections.abc import Awaitable, Callable
from dataclasses import replace

from guarded_opcua import (
    Limits,
    OwnCertificate,
    Pki,
    ServerSettings,
    ensure_certificate,
    load_certificate,
)
from valvemap.app.build import measures
from valvemap.app.history_span import DAY_S
from valvemap.app.identities import APPLICATION_NAME, APPLICATION_URI, PAGE_URI, PRODUCT, load_users
from valvemap.config.axes import AxisConfig
from valvemap.config.connections import SourceConfig
from valvemap.config.models import Config
from valvemap.config.secret_files import read_secret
from valvemap.config.valve_parts import EdgeConfig, LineConfig
from valvemap.config.valves import ValveConfig
from valvemap.errors import ConfigurationError
from valvemap.opcua_client.source_settings import Security, SourceSettings
from valvemap.opcua_source.client import OpcUaSource
from valvemap.opcua_source.source_nodes import ValveNodes
from valvemap.pipeline.axis_arrivals import LINES, line_words
from valvemap.pipeline.units import QUANTITY_OF
from valvemap.runtime.live_settings import LiveSettings
from valvemap.runtime.sources import Part, Sources
from valvemap.runtime.supervisor import SupervisorSettings
from valvemap.storage.history import HistoryFile

_HEARTBEAT_TICK_S = 0.1  # at least five heartbeats per second


def build_sources(config: Config, ready: Callable[[], Awaitable[None]] | None = None) -> Sources:
    """Return the clients of all source servers; ``ready`` is awaited before the first samples."""
    return _sources(config, _of_valves, ready)


def build_axis_sources(
    config: Config, ready: Callable[[], Awaitable[None]] | None = None
) -> Sources:
    """Return the clients of the servers of all axes: two rows of signals each, lines A and B."""
    return _sources(config, _of_axes, ready)


def build_source(config: Config, ready: Callable[[], Awaitable[None]] | None = None) -> OpcUaSource:
    """Return the client of the source server; ``ready`` is awaited before the first samples.

    Raises
    ------
    ConfigurationError
        if several sources are configured.
    """
    if config.sources:
        names = ", ".join(source.name for source in config.sources)
        raise ConfigurationError(f"there are several sources; name one with --source NAME: {names}")
    return _client(config, [nodes for _, nodes in _of_valves(config)], ready)


_Rows = list[tuple[str | None, ValveNodes]]  # the name of its source, and its nodes
_Ready = Callable[[], Awaitable[None]] | None


def _sources(config: Config, rows_of: Callable[[Config], _Rows], ready: _Ready) -> Sources:
    rows = rows_of(config)
    if not config.sources:
        every = tuple(range(len(rows)))
        client = _client(config, [nodes for _, nodes in rows], ready)
        return Sources([Part(None, client, every)] if rows else [])
    parts = []
    for source in config.sources:
        own = [n for n, (name, _) in enumerate(rows) if name == source.name]
        if own:
            client = _client(config.only(source.name), [rows[n][1] for n in own], ready)
            parts.append(Part(source.name, client, tuple(own)))
    return Sources(parts)


def _of_valves(config: Config) -> _Rows:
    return [(valve.source, _of_valve(valve)) for valve in config.valves]


def _of_valve(valve: ValveConfig) -> ValveNodes:
    part = valve if isinstance(valve, EdgeConfig | LineConfig) else None
    return ValveNodes(
        valve=valve.name,
        **valve.nodes.model_dump(),
        measures=measures(valve, QUANTITY_OF),
        insist=valve.insist,
        whole=None if part is None else part.valve,
        words={} if part is None else part.called,
    )


def _of_axes(config: Config) -> _Rows:
    return [(axis.source, _of_line(axis, line)) for axis in config.axes for line in range(LINES)]


def _of_line(axis: AxisConfig, line: int) -> ValveNodes:
    is_led = line == 0  # the first row of an axis
    words = line_words(line, has_speed=axis.nodes.speed is not None)
    measures = {signal: axis.signals.measure(word) for signal, word in words.items()}
    measures["required_U"] = axis.signals.measure("required_U")
    return ValveNodes(
        valve=axis.name,
        **{signal: getattr(axis.nodes, word) for signal, word in words.items()},
        sequence=axis.nodes.sequence,
        measures=measures,
        required_U=axis.nodes.required_U if is_led else None,
        heartbeat=axis.nodes.heartbeat if is_led else None,
        insist=axis.insist,
        kind="axis",
        words=words,
    )


def _client(config: Config, nodes: list[ValveNodes], ready: _Ready) -> OpcUaSource:
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
    return OpcUaSource(settings, nodes, ready=ready)


def build_server_settings(config: Config) -> ServerSettings:
    """Return identity, endpoint and users of the results server."""
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
    """Return the history file of signals and results; None if none is configured."""
    given = config.history
    if given.file is None:
        return None
    results = given.keep_days if given.results_days is None else given.results_days
    return HistoryFile(
        given.file,
        given.keep_days * DAY_S,
        given.most_mb * 1_000_000,
        results_s=results * DAY_S,
        trend_s=given.trend_days * DAY_S,
    )


def build_live_settings(config: Config, certificate: OwnCertificate | None) -> LiveSettings:
    """Return the time limits of the live service: stale results, checkpoints, certificate."""
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
    """Return the supervisor's start-up timeout and tick interval."""
    written = [valve.nodes.required_U for valve in config.valves]
    written += [axis.nodes.required_U for axis in config.axes]
    feeds_forward = any(node is not None for node in written)
    settings = SupervisorSettings(startup_timeout_s=config.source.startup_timeout_s)
    if config.sources:  # an outage of one does not delay the others
        settings = replace(settings, startup_timeout_s=0.0)
    return replace(settings, tick_s=_HEARTBEAT_TICK_S) if feeds_forward else settings


def own_certificate(config: Config) -> OwnCertificate:
    """Return the service's client and server certificate; create it at the first start."""
    names = config.server.host_names or ("localhost", "127.0.0.1")
    file_name = APPLICATION_NAME.replace(" ", "-")
    return ensure_certificate(Pki(config.security.pki), APPLICATION_URI, names, file_name)


def _password(source: SourceConfig) -> str | None:
    if source.password is not None:
        return source.password.get_secret_value()
    if source.password_file is None:
        return None
    return read_secret(source.password_file)
