"""The configuration as a whole: its sections, and what must fit between them."""

from typing import Any, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator
from pydantic_settings import SettingsConfigDict

from valvemap.config.alarms import ServiceAlarmsConfig
from valvemap.config.axes import AxisConfig
from valvemap.config.connections import (
    NamedSourceConfig,
    SecurityConfig,
    ServerConfig,
    SourceConfig,
)
from valvemap.config.dynamics import DynamicsConfig
from valvemap.config.logs import LogConfig
from valvemap.config.meters import check_meters
from valvemap.config.mqtt import MqttConfig
from valvemap.config.names import RESERVED_VALVES, check_not_reserved, check_unique
from valvemap.config.samples import AlignmentConfig
from valvemap.config.sections import SettingsFile
from valvemap.config.stores import HistoryConfig, RecordingConfig, StateConfig
from valvemap.config.valve_parts import parts_of
from valvemap.config.valves import ValveConfig


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
        check_not_reserved("axis", [axis.name for axis in axes], RESERVED_VALVES)
        names = [valve.name for valve in valves]
        check_unique("valve", names)
        check_unique("axis", names + [axis.name for axis in axes])
        check_not_reserved("valve", [valve.name for valve in valves], RESERVED_VALVES)
        return tuple(part for valve in valves for part in parts_of(valve))

    @model_validator(mode="after")
    def _sources_fit(self) -> Self:
        names = [source.name for source in self.sources]
        check_unique("source", names)
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
