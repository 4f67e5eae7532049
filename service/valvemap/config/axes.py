"""Configuration of an axis: a cylinder that is the flow meter of its valve."""

from dataclasses import replace
from typing import Annotated, Any, Final, Self

from pydantic import Field, create_model, field_validator, model_validator

from valvemap.config.feed_forward import (
    AxisFeedForwardConfig,
    check_command_unit,
    check_feed_forward,
)
from valvemap.config.names import NAME
from valvemap.config.ports import check_each_once, node_id
from valvemap.config.sections import Section
from valvemap.config.signals import SignalConfig
from valvemap.pipeline.units import Measure, Quantity, inside

_QUANTITIES: Final = {
    "U": Quantity.OPENING,
    "position": Quantity.LENGTH,
    "speed": Quantity.SPEED,
    "set_position": Quantity.LENGTH,
    **dict.fromkeys(("pA", "pB", "pS", "pT"), Quantity.PRESSURE),
    "T": Quantity.TEMPERATURE,
    "required_U": Quantity.OPENING,
}
"""The signals of an axis."""
_SENTENCES: Final = {
    "U": "control voltage; above 0 extends",
    "position": "position of the piston, 0 where it is retracted",
    "speed": "speed of the piston, above 0 extends; in place of position",
    "set_position": "position that the controller is to reach; the tracking error is shown",
    "pA": "pressure in the line of the piston's side",
    "pB": "pressure in the line of the rod's side",
    "pS": "supply pressure at the valve",
    "pT": "pressure in the tank line at the valve",
    "T": "oil temperature, where there is a sensor",
    "required_U": "the command that feed-forward writes",
}
MEASURED: Final = tuple(name for name in _SENTENCES if name != "required_U")
"""The signals that are read."""
_PRESSURES: Final = ("pA", "pB", "pS", "pT")
_ALONE: Final = (
    "position and command do not tell the flows: the same command gives another speed at another "
    "load"
)

Millimetres = Annotated[float, Field(gt=0.0, le=20_000.0)]
_OF_SIGNALS: dict[str, Any] = {
    name: (SignalConfig, Field(SignalConfig(), description=sentence))
    for name, sentence in _SENTENCES.items()
}


class AxisNodesConfig(Section):
    """Node ids at the source, as ``nsu=URI;s=NAME``, ``ns=2;s=NAME`` or ``ns=2;i=85``."""

    U: str = Field(description=_SENTENCES["U"])
    position: str | None = Field(None, description=_SENTENCES["position"])
    speed: str | None = Field(None, description=_SENTENCES["speed"])
    set_position: str | None = Field(None, description=_SENTENCES["set_position"])
    pA: str | None = Field(None, description=_SENTENCES["pA"])
    pB: str | None = Field(None, description=_SENTENCES["pB"])
    pS: str | None = Field(None, description=_SENTENCES["pS"])
    pT: str | None = Field(None, description=_SENTENCES["pT"])
    T: str | None = Field(None, description=_SENTENCES["T"])
    sequence: str | None = Field(None, description="running number of the sample")
    required_U: str | None = Field(
        None, description="where to write the feed-forward voltage, if at all"
    )
    heartbeat: str | None = Field(
        None,
        description="UInt32 that counts while the voltage is written; the source takes its own "
        "command when it stops or is 0",
    )

    @field_validator("*")
    @classmethod
    def _is_node_id(cls, text: str | None) -> str | None:
        return None if text is None else node_id(text)

    @model_validator(mode="after")
    def _has_every_pressure(self) -> Self:
        missing = [name for name in _PRESSURES if getattr(self, name) is None]
        if len(missing) == len(_PRESSURES):
            raise ValueError(f"pA, pB, pS and pT are missing: {_ALONE}")
        if missing:
            raise ValueError(
                f"{', '.join(missing)} missing: each edge needs the pressures on both its sides"
            )
        return self

    @model_validator(mode="after")
    def _has_position_or_speed(self) -> Self:
        if (self.position is None) == (self.speed is None):
            given = "both are given" if self.position is not None else "both are missing"
            raise ValueError(f"position, speed: {given}; one of them is needed")
        if self.set_position is not None and self.position is None:
            raise ValueError("set_position: position is needed, too; speed tells no tracking error")
        return self

    @model_validator(mode="after")
    def _heartbeat_is_of_a_command(self) -> Self:
        if self.heartbeat is not None and self.required_U is None:
            raise ValueError("heartbeat: required_U is needed, too; nothing is written without it")
        return self

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        check_each_once({name: getattr(self, name) for name in type(self).model_fields})
        return self


class AxisSignalsConfig(
    create_model("AxisSignals", __base__=Section, __doc__="", **_OF_SIGNALS)  # type: ignore[misc]
):
    """The signals of an axis: their units; without one, mm, mm/s, bar, % and °C."""

    @model_validator(mode="after")
    def _quantities_fit(self) -> Self:
        for name, quantity in _QUANTITIES.items():
            given: SignalConfig = getattr(self, name)
            given.check_quantity(name, quantity)
        return self

    def in_words(self, name: str) -> str:
        """Return unit and scaling of a signal in words."""
        given: SignalConfig = getattr(self, name)
        return given.in_words(_QUANTITIES[name])

    def measure(self, name: str) -> Measure:
        """Return unit and scaling of a signal."""
        given: SignalConfig = getattr(self, name)
        quantity = _QUANTITIES[name]
        measure = given.measure_of(quantity)
        return replace(measure, unit=measure.unit or inside(quantity))


class AxisConfig(Section):
    """A cylinder on a 4/3 valve: position or speed and four pressures replace a flow meter."""

    name: Annotated[str, Field(pattern=NAME)] = Field(description="its name in each node id")
    source: str | None = Field(
        None, description="which of [[sources]] publishes its signals; none with [source]"
    )
    nodes: AxisNodesConfig
    signals: AxisSignalsConfig = AxisSignalsConfig()
    feed_forward: AxisFeedForwardConfig = AxisFeedForwardConfig()
    piston_mm: Millimetres = Field(description="diameter of the piston")
    rod_mm: float = Field(ge=0.0, le=20_000.0, description="diameter of the rod, on side B")
    stroke_mm: Millimetres = Field(description="way between the end stops")
    dead_A_l: float = Field(
        gt=0.0, le=10_000.0, description="oil in hose and chamber A with the piston retracted, l"
    )
    dead_B_l: float | None = Field(
        None, gt=0.0, le=10_000.0, description="the same of B, extended; none: as dead_A_l"
    )
    memory_s: float = Field(
        1_800.0, ge=60.0, le=1e9, description="time constant of forgetting, s of movement"
    )
    frozen: bool = Field(
        default=False, description="keep the stored map as it is: learn and find nothing"
    )
    insist: bool = Field(
        default=False, description="take the source's units as they are, though they differ"
    )

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
    def _command_has_a_unit(self) -> Self:
        check_command_unit(
            self.signals.measure("U").scaling("U"),
            self.signals.required_U.model_fields_set,
            is_written=self.nodes.required_U is not None,
        )
        return self

    @model_validator(mode="after")
    def _rod_fits(self) -> Self:
        if self.rod_mm >= self.piston_mm:
            raise ValueError(f"rod_mm = {self.rod_mm:g}: must be less than {self.piston_mm:g}")
        return self
