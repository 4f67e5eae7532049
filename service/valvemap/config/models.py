"""The configuration's sections and fields, with units in the names, bounds and defaults."""

from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    Field,
    SecretStr,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_settings import SettingsConfigDict

from valvemap.config.alarms import AlarmsConfig, ServiceAlarmsConfig
from valvemap.config.axes import AxisConfig
from valvemap.config.commission import CommissionConfig
from valvemap.config.dynamics import DynamicsConfig
from valvemap.config.estimators import (
    SECTIONS,
    AutoConfig,
    EstimatorConfig,
    default_estimators,
)
from valvemap.config.feed_forward import FeedForwardConfig, check_command_unit, check_feed_forward
from valvemap.config.logs import LogConfig
from valvemap.config.meters import check_meters
from valvemap.config.mqtt import MqttConfig
from valvemap.config.nameplate import IdentificationConfig
from valvemap.config.ports import PortsConfig, check_each_once, node_id
from valvemap.config.sections import Section, SettingsFile, per_signal
from valvemap.config.signals import SignalsConfig
from valvemap.model.extrapolation import ONE_EDGE
from valvemap.pipeline.quality_gate import SignalLimits
from valvemap.vocabulary.edges import PARTS, Edge
from valvemap.vocabulary.signals import IN_DIFFERENCE, Measured, Need, Signal

RIG_NAMESPACE = "urn:valvemap:rig"
_OF_ANY_RANGE = [f'"{kind}"' for kind, section in SECTIONS.items() if section.any_U_range]
RESERVED_VALVES = ("Identification", "Service")  # names of other nodes
RESERVED_ESTIMATORS = (
    "Signals",
    "Alarms",
    "Baseline",
    "Diagnostics",
    "Dynamics",
    "Commission",
    "Inverse",
    "Frame",
    "FrameNames",
    "Identification",
    "DeviceHealth",
    "NodeVersion",
    "Recommended",
    "RecommendedReason",
    "Edge",
    "Meter",
    "ProcessValues",
    *PARTS,
)
RECOMMENDED = "recommended"  # value of ``inverse``
_NOT_WITH_PORTS = {
    "commission": "a sweep of one edge is not offered yet",
    "nodes": "leave out nodes, or ports",
    "signals": "its units and columns are in ports.signals",
    "feed_forward": "nothing is written to it",
}

Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,63}$")]
SecurityPolicy = Literal["None", "Basic256Sha256", "Aes256Sha256RsaPss"]
Range = tuple[float, float]


class SourceConfig(Section):
    """The OPC UA server that publishes the signals."""

    url: str = Field(
        "opc.tcp://127.0.0.1:4840/valvemap/rig/",
        pattern=r"^opc\.tcp://[^\s/]+(:\d+)?(/\S*)?$",
        description="opc.tcp://HOST:PORT/PATH",
    )
    security: SecurityPolicy = Field(
        "Basic256Sha256", description="policy of the connection, SignAndEncrypt unless None"
    )
    user: str | None = Field(None, description="user name; none = anonymous")
    password: SecretStr | None = Field(None, description="better by the environment or a file")
    password_file: Path | None = Field(None, description="file whose first line is the password")
    check_host_name: bool = Field(
        default=True, description="the source's certificate must name the host of the url"
    )
    publishing_interval_ms: float = Field(
        100.0, ge=1.0, le=60_000.0, description="interval at which the source sends changes"
    )
    queue_size: int = Field(
        1_000, ge=1, le=1_000_000, description="samples per signal in the source's queue"
    )
    history_s: float = Field(
        3_600.0,
        ge=0.0,
        le=2_592_000.0,
        description="how far back missed samples are read from its history; 0 = never",
    )
    warm_start_s: float = Field(
        0.0,
        ge=0.0,
        le=2_592_000.0,
        description="length of its history that is learnt at the first start, before live samples",
    )
    timeout_s: float = Field(4.0, gt=0.0, le=600.0, description="longest wait for a response")
    startup_timeout_s: float = Field(
        10.0, ge=0.0, description="wait this long for the source at start; 0 = for ever"
    )


class NamedSourceConfig(SourceConfig):
    """One of several servers that publish signals; valves name theirs."""

    name: Name = Field(description="name by which valves refer to it")


class ServerConfig(Section):
    """The service's OPC UA server, which publishes the results."""

    url: str = Field(
        "opc.tcp://127.0.0.1:4841/valvemap/service/",
        pattern=r"^opc\.tcp://[^\s/]+:\d+(/\S*)?$",
        description="opc.tcp://ADDRESS:PORT/PATH to listen on",
    )
    host_names: tuple[str, ...] = Field(
        (), description="host names by which clients reach the server, for its certificate"
    )
    anonymous_observer: bool = Field(
        default=False, description="let anonymous users read on the secured endpoints"
    )
    min_publishing_interval_ms: float = Field(
        50.0, ge=1.0, le=60_000.0, description="shortest publishing interval that a client may have"
    )
    results_interval_ms: float = Field(
        0.0,
        ge=0.0,
        le=60_000.0,
        description="shortest time between two results of a valve in its single variables; Frame "
        "has them all",
    )


class SecurityConfig(Section):
    """Certificates and users."""

    pki: Path = Field(Path("data/pki/service"), description="folder of certificates and keys")
    users: Path = Field(Path("data/users.json"), description="users and hashed passwords")
    require_crl: bool = Field(
        default=True,
        description="a certificate of an authority needs its revocation list; a self-signed one"
        " does not",
    )


class StateConfig(Section):
    """The states that survive a restart."""

    file: Path = Field(Path("data/state.sqlite"), description="SQLite file of the states")
    checkpoint_interval_s: float = Field(
        10.0, ge=0.1, le=86_400.0, description="interval at which states are saved"
    )


class HistoryConfig(Section):
    """The recorded signals and results, for trends."""

    file: Path | None = Field(
        None, description="SQLite file of the history; none: there is no history"
    )
    keep_days: float = Field(
        7.0,
        gt=0.0,
        le=3_650.0,
        description="age at which values, and their summaries of 10 s, are deleted, in days",
    )
    results_days: float | None = Field(
        None,
        gt=0.0,
        le=3_650.0,
        description="age at which values of results are deleted, in days; none: keep_days",
    )
    trend_days: float = Field(
        30.0,
        gt=0.0,
        le=3_650.0,
        description="age at which summaries of 5 min are deleted, in days; at least keep_days",
    )
    most_mb: int = Field(
        2_000,
        ge=10,
        le=1_000_000,
        description="size above which the oldest values are deleted, in MB; results first",
    )


class AlignmentConfig(Section):
    """How the signals of one sample are aligned."""

    tolerance_ms: float = Field(
        0.0,
        ge=0.0,
        le=10_000.0,
        description="largest difference of the times within one sample; 0 = found at the start",
    )
    max_wait_s: float = Field(
        2.0, gt=0.0, le=3_600.0, description="longest wait for a signal that is missing"
    )
    reorder_ms: float = Field(
        1_000.0,
        ge=0.0,
        le=60_000.0,
        description="longest wait behind a gap in nodes.sequence; if given, valves without a "
        "sequence wait this long with every sample",
    )
    max_pending: int = Field(
        4_096, ge=16, le=1_000_000, description="most waiting samples of a valve"
    )
    hold_s: dict[Measured, float] = Field(
        default_factory=dict,
        description="time for which a signal's last value is held; none = found at the start",
    )
    find_timing: bool = Field(
        default=True,
        description="find the timing of signals without a common time at the start, unless "
        "tolerance_ms or hold_s state it",
    )
    stale_after_s: float = Field(
        2.0, gt=0.0, le=3_600.0, description="time without a sample after which results are Bad"
    )

    @property
    def finds_timing(self) -> bool:
        """Whether the timing of the signals is detected instead of configured."""
        return self.find_timing and self.tolerance_ms == 0.0 and not self.hold_s


class LimitsConfig(Section):
    """Limits of one signal in its unit; an omitted limit is not checked."""

    low: float | None = Field(None, description="lowest accepted value")
    high: float | None = Field(None, description="highest accepted value")
    frozen_s: float | None = Field(
        None, gt=0.0, description="longest time that the value may be constant"
    )
    max_rate_per_s: float | None = Field(
        None, gt=0.0, description="fastest accepted change, per second"
    )
    spike: float | None = Field(
        None, gt=0.0, description="largest distance from the median of the last five values"
    )

    @model_validator(mode="after")
    def _low_below_high(self) -> Self:
        if self.low is not None and self.high is not None and self.low >= self.high:
            raise ValueError(f"low {self.low:g} must be below high {self.high:g}")
        return self

    def limits(self, signal: Signal) -> SignalLimits:
        """Return the gate's limits; the range defaults to that of any real sensor."""
        low, high = signal.plausible
        return SignalLimits(
            low=low if self.low is None else self.low,
            high=high if self.high is None else self.high,
            frozen_s=self.frozen_s or 0.0,
            max_rate_per_s=self.max_rate_per_s or np.inf,
            spike=self.spike or np.inf,
        )


class GateConfig(per_signal("Limits", lambda _: (LimitsConfig, LimitsConfig()))):  # type: ignore[misc]
    """Which samples may teach the estimators."""

    use_uncertain: bool = Field(
        default=False, description="learn from values whose status is Uncertain"
    )


def _node_field(signal: Signal) -> tuple[Any, Any]:
    if signal.label in IN_DIFFERENCE:
        return str | None, Field(None, description=signal.sentence)
    if signal.need is Need.REQUIRED:
        return str, Field(description=signal.sentence)
    sensor = ", where there is a sensor" if signal.need is Need.OPTIONAL else ""
    return str | None, Field(None, description=signal.sentence + sensor)


class NodesConfig(per_signal("NodesOfSignals", _node_field, Signal)):  # type: ignore[misc]
    """Node ids at the source, as ``nsu=URI;s=NAME``, ``ns=2;s=NAME`` or ``ns=2;i=85``.

    An element of an array is ``index=3;nsu=URI;s=NAME``, counted from 0.
    """

    dp: str | None = Field(
        None, description="p1 - p2 of one transmitter, in place of p1 and p2: p2 is 0 then"
    )
    required_U: str | None = Field(
        None, description="where to write the feed-forward voltage, if at all"
    )
    heartbeat: str | None = Field(
        None,
        description="UInt32 that counts while the voltage is written; the source takes its own "
        "command when it stops or is 0",
    )
    load: str | None = Field(
        None,
        description="where commissioning writes the set point of the load (p2), if at all; "
        "under the same heartbeat",
    )

    @model_validator(mode="after")
    def _heartbeat_is_of_a_command(self) -> Self:
        if self.heartbeat is not None and self.required_U is None:
            raise ValueError("heartbeat: required_U is needed, too; nothing is written without it")
        if self.load is not None and self.heartbeat is None:
            raise ValueError("load: heartbeat is needed, too; the source would keep the last load")
        return self

    @model_validator(mode="after")
    def _has_pressures(self) -> Self:
        pair = self.p1 is not None, self.p2 is not None
        if self.dp is None and not all(pair):
            missing = "p1" if not pair[0] else "p2"
            raise ValueError(f"{missing} is missing; p1 and p2 are needed, or dp alone")
        if self.dp is not None and any(pair):
            raise ValueError("dp takes the place of p1 and p2; leave out dp, or both of them")
        return self

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        check_each_once({name: self.of(name) for name in type(self).model_fields})
        return self

    @field_validator("*")
    @classmethod
    def _is_node_id(cls, text: str | None) -> str | None:
        return None if text is None else node_id(text)

    def source_of(self, name: str) -> str:
        """Return the field that holds a signal's node: dp for p1, where there is dp."""
        return "dp" if name == "p1" and self.dp is not None else name

    def of(self, name: str) -> str | None:
        """Return the node of a signal, if there is one."""
        node: str | None = getattr(self, name)
        return node

    @classmethod
    def of_rig(cls, valve: str, *, commanded: bool = False, loaded: bool = False) -> Self:
        """Return the virtual rig's nodes; the written ones if ``commanded``, ``loaded``."""
        head = f"nsu={RIG_NAMESPACE};s={valve}."
        return cls(
            **{signal.label: head + signal.at_rig for signal in Signal},
            required_U=head + "UCommand" if commanded else None,
            heartbeat=head + "Heartbeat" if commanded else None,
            load=head + "LoadCommand" if loaded else None,
        )


class ValveConfig(Section):
    """One valve."""

    name: Name = Field("Valvistor", description="its name in each node id")
    source: Name | None = Field(
        None, description="which of [[sources]] publishes its signals; none with [source]"
    )
    nodes: NodesConfig = Field(default_factory=lambda: NodesConfig.of_rig("Valvistor"))
    ports: PortsConfig | None = Field(
        None, description="nodes by port, in place of nodes: four edges, or two ports"
    )
    signals: SignalsConfig = SignalsConfig()
    feed_forward: FeedForwardConfig = FeedForwardConfig()
    commission: CommissionConfig = CommissionConfig()
    gate: GateConfig = GateConfig()
    alarms: AlarmsConfig = AlarmsConfig()
    identification: IdentificationConfig = IdentificationConfig()
    insist: bool = Field(
        default=False, description="learn from implausible data, such as p1 below p2"
    )
    estimators: tuple[EstimatorConfig, ...] = Field(default_factory=default_estimators)
    U_range_percent: Range = Field((0.0, 100.0), description="range of U that the map covers")
    dp_range_bar: Range = Field((0.0, 200.0), description="range of p1 - p2 that the map covers")
    Q_range_l_min: Range = Field((0.0, 200.0), description="range of the flow")
    inverse: str | None = Field(
        None,
        description="name of the estimator whose map is inverted, or recommended: the one with the "
        "least error at places visited again, until then Auto or the first; none = recommended",
    )

    @model_validator(mode="before")
    @classmethod
    def _nodes_of_the_rig_by_default(cls, given: Any) -> Any:  # noqa: ANN401 - pydantic's raw input
        if not isinstance(given, dict) or {"nodes", "ports"} & given.keys():
            return given
        if isinstance(given.get("name"), str):
            return {**given, "nodes": NodesConfig.of_rig(given["name"])}
        return given

    @field_validator("U_range_percent", "dp_range_bar", "Q_range_l_min")
    @classmethod
    def _low_below_high(cls, bounds: Range) -> Range:
        if not bounds[0] < bounds[1]:
            raise ValueError(f"the first number must be below the second, not {list(bounds)}")
        return bounds

    @field_validator("U_range_percent")
    @classmethod
    def _estimators_can_describe_it(cls, bounds: Range, info: ValidationInfo) -> Range:
        estimators: tuple[EstimatorConfig, ...] = info.data.get("estimators", ())
        unable = [e.name for e in estimators if not e.any_U_range]
        if info.data.get("ports") is not None:
            return bounds  # each of its edges has one sign of U
        if unable and (bounds[0] < ONE_EDGE[0] or bounds[1] > ONE_EDGE[1]):
            raise ValueError(
                f"[{bounds[0]:g}, {bounds[1]:g}] is more than {', '.join(unable)} can describe; "
                f"with them {ONE_EDGE[0]:g} … {ONE_EDGE[1]:g} is allowed, any range with "
                f"estimators of the kind {' or '.join(_OF_ANY_RANGE)} alone"
            )
        return bounds

    @model_validator(mode="after")
    def _ports_stand_alone(self) -> Self:
        if self.ports is None:
            return self
        for name, remedy in _NOT_WITH_PORTS.items():
            if name in self.model_fields_set:
                raise ValueError(f"{name} is not for a valve with ports: {remedy}")
        low, high = self.U_range_percent
        if "U_range_percent" in self.model_fields_set and not low < 0.0 < high:
            raise ValueError(
                f"a valve with ports works both ways: U_range_percent = [{low:g}, {high:g}], "
                "[-100, 100] is meant"
            )
        return self

    @model_validator(mode="after")
    def _feed_forward_fits(self) -> Self:
        check_feed_forward(
            self.feed_forward,
            is_given="feed_forward" in self.model_fields_set,
            is_written=self.nodes.required_U is not None,
            has_heartbeat=self.nodes.heartbeat is not None,
        )
        return self

    @model_validator(mode="after")
    def _commission_fits(self) -> Self:
        self.commission.check_within(self.U_range_percent, has_load=self.nodes.load is not None)
        return self

    @model_validator(mode="after")
    def _command_has_a_unit(self) -> Self:
        check_command_unit(
            self.signals.U.measure("U").scaling("U"),
            self.signals.required_U.model_fields_set,
            is_written=self.nodes.required_U is not None,
        )
        return self

    @model_validator(mode="after")
    def _names_fit(self) -> Self:
        names = [estimator.name for estimator in self.estimators]
        if not names:
            raise ValueError("estimators: at least one is needed")
        _unique("estimator", names)
        _not_reserved("estimator", names, RESERVED_ESTIMATORS)
        if self.inverse not in (None, RECOMMENDED, *names):
            allowed = ", ".join((RECOMMENDED, *names))
            raise ValueError(f"inverse = {self.inverse!r}: allowed is one of {allowed}")
        return self


class EdgeConfig(ValveConfig):
    """One edge of a valve with ports; made from that valve, never read from a file."""

    valve: str = ""
    edge: Edge = Edge.PA


class LineConfig(ValveConfig):
    """One line of a valve with ports; made from that valve, never read from a file."""

    valve: str = ""
    line: str = "A"
    closed_percent: float = 3.0
    not_learnt: tuple[str, ...] = ()  # which edges of the valve are not, and why


def parts_of(valve: ValveConfig) -> tuple[ValveConfig, ...]:
    """Return the valves that stand for a valve: itself, or its lines and edges."""
    ports = valve.ports
    if ports is None:
        return (valve,)
    low, high = (
        valve.U_range_percent if "U_range_percent" in valve.model_fields_set else (-100.0, 100.0)
    )
    if ports.is_two_port:
        own = {} if "estimators" in valve.model_fields_set else {"estimators": (AutoConfig(),)}
        signals = {**ports.drop(Edge.PA), "Q": "QA"}
        kept = {n: getattr(valve, n) for n in valve.model_fields_set - {"ports"}}
        given = {**kept, **own, "U_range_percent": (low, high)}
        return (ValveConfig(**given, **_of_part(ports, signals)),)
    found: list[ValveConfig] = []
    edges = ports.learnt
    left_out = tuple(f"{edge} is not learnt: {why}" for edge, why in ports.not_learnt())
    for line in ports.lines:
        if not any(edge.line == line for edge in edges):
            continue
        head = {"name": f"{valve.name}.Line{line}", "valve": valve.name, "line": line}
        most = valve.dp_range_bar[1]
        bounds = {"U_range_percent": (low, high), "dp_range_bar": (-most, most)}
        signals = {**ports.leak(line), "Q": f"Q{line}"}
        found.append(
            _made(
                LineConfig,
                valve,
                **head,
                **bounds,
                **_of_part(ports, signals),
                estimators=(),
                inverse=None,
                insist=True,
                closed_percent=ports.closed_percent,
                not_learnt=left_out if not found else (),
            )
        )
    for edge in edges:
        head = {"name": f"{valve.name}.{edge}", "valve": valve.name, "edge": edge}
        bounds = {"U_range_percent": (0.0, high if edge.opens > 0 else -low)}
        signals = {**ports.drop(edge), "Q": f"Q{edge.line}"}
        found.append(_made(EdgeConfig, valve, **head, **bounds, **_of_part(ports, signals)))
    return tuple(found)


def _made(kind: type[ValveConfig], whole: ValveConfig, /, **own: Any) -> ValveConfig:  # noqa: ANN401
    """Return a part of a valve: its name is not one that a file may have."""
    given = {name: getattr(whole, name) for name in ValveConfig.model_fields if name != "ports"}
    return kind.model_construct(**(given | own))


def _of_part(ports: PortsConfig, signals: dict[str, str]) -> dict[str, Any]:
    """Return nodes and signals of an edge or line, from the names that they have among ports."""
    named = {"U": "U", **signals} | ({} if ports.T is None else {"T": "T"})
    nodes = {signal: ports.node(name) for signal, name in named.items()}
    return {
        "nodes": NodesConfig(**nodes, sequence=ports.sequence),
        "signals": ports.signals.of(**named),
    }


class RecordingConfig(Section):
    """Columns of recordings that are not signals of a valve; if omitted, they are found by name."""

    time: str | None = Field(None, min_length=1, description="column of the times")
    valve: str | None = Field(None, min_length=1, description="column of the valves' names")
    quality: str | None = Field(None, min_length=1, description="column of the qualities")


class Config(SettingsFile):
    """The whole configuration: a TOML file, overridden by ``VALVEMAP_<SECTION>__<FIELD>``."""

    model_config = SettingsConfigDict(env_prefix="VALVEMAP_")

    source: SourceConfig = SourceConfig()
    sources: tuple[NamedSourceConfig, ...] = Field(
        (), description="several servers in place of [source]; each valve names its own"
    )
    server: ServerConfig = ServerConfig()
    security: SecurityConfig = SecurityConfig()
    state: StateConfig = StateConfig()
    history: HistoryConfig = HistoryConfig()
    alignment: AlignmentConfig = AlignmentConfig()
    log: LogConfig = LogConfig()
    recording: RecordingConfig = RecordingConfig()
    alarms: ServiceAlarmsConfig = ServiceAlarmsConfig()
    mqtt: MqttConfig = MqttConfig()
    dynamics: DynamicsConfig = DynamicsConfig()
    axes: tuple[AxisConfig, ...] = Field((), description="cylinders as flow meters of their valves")
    valves: tuple[ValveConfig, ...] = Field(default_factory=lambda: (ValveConfig(),))

    @model_validator(mode="before")
    @classmethod
    def _axes_need_no_valve(cls, given: Any) -> Any:  # noqa: ANN401 - pydantic's raw input
        if isinstance(given, dict) and given.get("axes") and "valves" not in given:
            return {**given, "valves": ()}
        return given

    @field_validator("valves")
    @classmethod
    def _valve_names_differ(
        cls, valves: tuple[ValveConfig, ...], info: ValidationInfo
    ) -> tuple[ValveConfig, ...]:
        axes: tuple[AxisConfig, ...] = info.data.get("axes", ())
        if not valves and not axes:
            raise ValueError("at least one valve is needed")
        _not_reserved("axis", [axis.name for axis in axes], RESERVED_VALVES)
        names = [valve.name for valve in valves]
        _unique("valve", names)
        _unique("axis", names + [axis.name for axis in axes])
        _not_reserved("valve", [valve.name for valve in valves], RESERVED_VALVES)
        return tuple(part for valve in valves for part in parts_of(valve))

    @model_validator(mode="after")
    def _sources_fit(self) -> Self:
        names = [source.name for source in self.sources]
        _unique("source", names)
        if names and "source" in self.model_fields_set:
            raise ValueError("[source] and [[sources]]: only one of both is allowed")
        of_valves = [(f"valves[{n}].source", valve.source) for n, valve in enumerate(self.valves)]
        of_axes = [(f"axes[{n}].source", axis.source) for n, axis in enumerate(self.axes)]
        for where, source in (*of_valves, *of_axes):
            if not names and source is not None:
                raise ValueError(f"{where} = {source!r}: there are no [[sources]]")
            if names and source not in names:
                given = "is missing" if source is None else f"= {source!r}"
                raise ValueError(f"{where} {given}: allowed is one of {', '.join(names)}")
        idle = sorted(set(names) - {source for _, source in (*of_valves, *of_axes)})
        if idle:
            raise ValueError(f"source {idle[0]!r} is named by no valve")
        return self

    @model_validator(mode="after")
    def _meters_can_be_divided(self) -> Self:
        check_meters(self.valves)
        return self

    @property
    def all_sources(self) -> tuple[SourceConfig, ...]:
        """[source], or all [[sources]]."""
        return self.sources or (self.source,)

    def source_of(self, valve: ValveConfig | AxisConfig) -> SourceConfig:
        """Return the server that publishes a valve's or an axis's signals."""
        return next((s for s in self.sources if s.name == valve.source), self.source)

    def only(self, source: str) -> Self:
        """Return the configuration of one of [[sources]] as [source], with its valves only."""
        (own,) = (s for s in self.sources if s.name == source)
        given = {name: getattr(own, name) for name in own.model_fields_set - {"name"}}
        mine = {
            kind: tuple(
                one.model_copy(update={"source": None}) for one in every if one.source == source
            )
            for kind, every in (("valves", self.valves), ("axes", self.axes))
        }
        return self.model_copy(update={"source": SourceConfig(**given), "sources": (), **mine})

    @model_validator(mode="after")
    def _samples_come_often_enough(self) -> Self:
        led: list[tuple[str, int, ValveConfig | AxisConfig]] = [
            *(("valves", n, valve) for n, valve in enumerate(self.valves)),
            *(("axes", n, axis) for n, axis in enumerate(self.axes)),
        ]
        for kind, number, valve in led:
            interval_s = self.source_of(valve).publishing_interval_ms * 1e-3
            max_age_s = valve.feed_forward.max_age_s
            if valve.nodes.required_U is not None and max_age_s <= interval_s:
                raise ValueError(
                    f"{kind}[{number}].feed_forward.max_age_s = {max_age_s:g}: must be longer than "
                    f"source.publishing_interval_ms = {interval_s * 1e3:g}"
                )
        return self


def _unique(what: str, names: list[str]) -> None:
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"{what} name {twice[0]!r} is taken twice")


def _not_reserved(what: str, names: list[str], reserved: tuple[str, ...]) -> None:
    for name in names:
        if name in reserved:
            raise ValueError(f"{what} name {name!r} is taken: reserved are {', '.join(reserved)}")
