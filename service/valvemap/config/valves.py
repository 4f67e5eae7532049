"""The section of a valve: its nodes, signals, estimators and parts."""

from typing import Any, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from valvemap.config.alarms import AlarmsConfig
from valvemap.config.commission import CommissionConfig
from valvemap.config.estimators import SECTIONS, EstimatorConfig, default_estimators
from valvemap.config.feed_forward import FeedForwardConfig, check_command_unit, check_feed_forward
from valvemap.config.nameplate import IdentificationConfig
from valvemap.config.names import RESERVED_ESTIMATORS, Name, check_not_reserved, check_unique
from valvemap.config.ports import PortsConfig, check_each_once, node_id
from valvemap.config.samples import GateConfig
from valvemap.config.sections import Range, Section, per_signal
from valvemap.config.signals import SignalsConfig
from valvemap.model.extrapolation import ONE_EDGE
from valvemap.vocabulary.signals import IN_DIFFERENCE, Need, Signal

RIG_NAMESPACE = "urn:valvemap:rig"
_OF_ANY_RANGE = [f'"{kind}"' for kind, section in SECTIONS.items() if section.any_U_range]
RECOMMENDED = "recommended"  # value of ``inverse``
_NOT_WITH_PORTS = {
    "commission": "a sweep of one edge is not offered yet",
    "nodes": "leave out nodes, or ports",
    "signals": "its units and columns are in ports.signals",
    "feed_forward": "nothing is written to it",
}


def _node_field(signal: Signal) -> tuple[Any, Any]:
    if signal.label in IN_DIFFERENCE:
        return str | None, Field(None, description=signal.sentence)
    if signal.need is Need.REQUIRED:
        return str, Field(description=signal.sentence)
    sensor = ", where there is a sensor" if signal.need is Need.OPTIONAL else ""
    return str | None, Field(None, description=signal.sentence + sensor)


class NodesConfig(per_signal("NodesOfSignals", _node_field, Signal)):  # type: ignore[misc]
    """Node ids at the source, as ``nsu=URI;s=NAME``, ``ns=2;s=NAME`` or ``ns=2;i=85``.

    An element of an array is ``index=3;nsu=URI;s=NAME``, counted from 0; a member of a structure
    ``member=Inlet.Pressure;nsu=URI;s=NAME``, ``member=Gauges[2].Value;…`` in an array.
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

    @field_validator("U_range_percent")
    @classmethod
    def _estimators_can_describe_it(cls, bounds: Range, info: ValidationInfo) -> Range:
        estimators: tuple[EstimatorConfig, ...] = info.data.get("estimators", ())
        unable = [e.name for e in estimators if not e.any_U_range]
        if info.data.get("ports") is not None:
            return bounds  # each of its edges has one sign of U
        if unable and (bounds[0] < ONE_EDGE[0] or bounds[1] > ONE_EDGE[1]):
            raise ValueError(
                f"more than {', '.join(unable)} can describe; "
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
        nodes = self.nodes
        self.commission.check_within(
            self.U_range_percent,
            is_driven=nodes.required_U is not None,
            has_load=nodes.load is not None,
            has_p2=nodes.p2 is not None,
        )
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
        check_unique("estimator", names)
        check_not_reserved("estimator", names, RESERVED_ESTIMATORS)
        if self.inverse not in (None, RECOMMENDED, *names):
            allowed = ", ".join((RECOMMENDED, *names))
            raise ValueError(f"inverse = {self.inverse!r}: allowed is one of {allowed}")
        return self
