"""Configuration of a valve with ports: its nodes by port, edges and lines."""

from collections.abc import Iterator, Mapping
from typing import Any, Final, Literal, Self

from pydantic import Field, create_model, field_validator, model_validator

from valvemap.config.sections import Section
from valvemap.config.signals import SignalConfig, SignalsConfig
from valvemap.pipeline.units import QUANTITY_OF
from valvemap.vocabulary.edges import LINES, Edge, edges_of

EdgeName = Literal["PA", "AT", "PB", "BT"]

SIGNAL_OF: Final = {
    "U": "U",
    **{f"p{port}": "p1" for port in "PTAB"},
    **{f"Q{line}": "Q" for line in LINES},
    **{f"dp{edge}": "dp" for edge in Edge},
    "T": "T",
}
"""For each signal of a valve with ports, that of a valve with one edge."""

_SENTENCES: Final = {
    "U": "control voltage, negative where PB and AT open",
    "T": "oil temperature, where there is a sensor",
    **{f"p{port}": f"pressure at port {port}" for port in "PTAB"},
    **{f"Q{line}": f"flow out of the valve into line {line}" for line in LINES},
    **{
        f"dp{edge}": f"p{edge.of} - p{edge.to} of one transmitter, in place of both"
        for edge in Edge
    },
}
_OF_PORT_SIGNALS: dict[str, Any] = {
    name: (SignalConfig, Field(SignalConfig(), description=_SENTENCES[name])) for name in SIGNAL_OF
}
_OF_PORT_NODES: dict[str, Any] = {
    name: (str, Field(description=sentence))
    if name == "U"
    else (str | None, Field(None, description=sentence))
    for name, sentence in _SENTENCES.items()
}


class PortSignalsConfig(
    create_model("PortSignals", __base__=Section, __doc__="", **_OF_PORT_SIGNALS)  # type: ignore[misc]
):
    """The signals of a valve with ports: their columns in recordings, and their units."""

    @model_validator(mode="after")
    def _quantities_fit(self) -> Self:
        for name, signal in SIGNAL_OF.items():
            given: SignalConfig = getattr(self, name)
            unit, quantity = given.measure(signal).unit, QUANTITY_OF[signal]
            if unit is not None and unit.quantity is not quantity:
                raise ValueError(
                    f"the unit of {name}, {given.unit!r}, is one of {unit.quantity.noun}; "
                    f"a unit of {quantity.noun} is needed, such as {quantity.value}"
                )
        return self

    def of(self, **names: str) -> SignalsConfig:
        """Return the signals of one edge or line, given by their names here.

        A recording has the names here as headings, unless a column is configured.
        """
        found = {}
        for signal, name in names.items():
            given: SignalConfig = getattr(self, name)
            column = name if given.column is None and name not in ("U", "T") else given.column
            found[signal] = given.model_copy(update={"column": column})
        return SignalsConfig(**found)


class PortsConfig(
    create_model("PortNodes", __base__=Section, __doc__="", **_OF_PORT_NODES)  # type: ignore[misc]
):
    """Node ids at the source by port, in place of ``nodes``; others may be left out.

    P and A alone are a valve with two ports that works both ways.
    """

    sequence: str | None = Field(None, description="running number of the sample")
    edges: tuple[EdgeName, ...] | None = Field(
        None, description="edges to learn; none: each whose pressures and flow are given"
    )
    closed_percent: float = Field(
        3.0,
        gt=0.0,
        le=50.0,
        description="largest U, of either sign, at which all edges are closed: leakage is learnt",
    )
    signals: PortSignalsConfig = PortSignalsConfig()

    @field_validator("*")
    @classmethod
    def _is_node_id(cls, given: Any) -> Any:  # noqa: ANN401 - any field's value
        return node_id(given) if isinstance(given, str) else given

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        check_each_once({name: self.node(name) for name in (*SIGNAL_OF, "sequence")})
        return self

    @model_validator(mode="after")
    def _something_can_be_learnt(self) -> Self:
        if not self.lines:
            raise ValueError(
                "a flow is missing, QA or QB: an edge is learnt from the flow in its line"
            )
        for line in self.lines:
            if not any(self._has_drop(edge) for edge in edges_of(line)):
                raise ValueError(
                    f"line {line} has a flow, Q{line}, and no pressure drop: p{line} with pP or pT "
                    f"is needed, or dpP{line}, or dp{line}T"
                )
        return self

    @model_validator(mode="after")
    def _chosen_edges_are_there(self) -> Self:
        if self.edges is not None:
            if not self.edges or len(set(self.edges)) < len(self.edges):
                raise ValueError("edges: each once, and at least one")
            for edge in map(Edge, self.edges):
                missing = self._missing(edge)
                if missing:
                    raise ValueError(f"edges: {edge} cannot be learnt, {missing} is missing")
        return self

    @property
    def lines(self) -> tuple[str, ...]:
        """The lines with a flow."""
        return tuple(line for line in LINES if self.node(f"Q{line}") is not None)

    @property
    def is_two_port(self) -> bool:
        """Whether it is a valve with two ports that works both ways."""
        others = {"pT", "pB", "QB", "dpAT", "dpPB", "dpBT"}
        return self.edges is None and all(self.node(name) is None for name in others)

    @property
    def learnt(self) -> tuple[Edge, ...]:
        """The edges that are learnt."""
        chosen = set(Edge if self.edges is None else map(Edge, self.edges))
        return tuple(edge for edge in Edge if edge in chosen and not self._missing(edge))

    def not_learnt(self) -> Iterator[tuple[Edge, str]]:
        """Yield each edge that is not learnt, and why."""
        for edge in Edge:
            missing = self._missing(edge)
            if missing:
                yield edge, f"{missing} is missing"
            elif edge not in self.learnt:
                yield edge, "it is not among edges"

    def drop(self, edge: Edge) -> dict[str, str]:
        """Return the names here of the signals that give the pressure drop over an edge."""
        if self.node(f"dp{edge}") is not None:
            return {"dp": f"dp{edge}"}
        return {"p1": f"p{edge.of}", "p2": f"p{edge.to}"}

    def leak(self, line: str) -> dict[str, str]:
        """Return the names here of the pressures that drive the leakage of a line.

        To the other line, or, where its pressure is not known, to the tank; else over the edge
        that there is.
        """
        other = next(one for one in LINES if one != line)
        for port in (other, "T"):
            if self.node(f"p{line}") is not None and self.node(f"p{port}") is not None:
                return {"p1": f"p{line}", "p2": f"p{port}"}
        first, second = edges_of(line)
        return self.drop(second if self._has_drop(second) else first)

    def node(self, name: str) -> str | None:
        """Return the node of a signal, if there is one."""
        found: str | None = getattr(self, name)
        return found

    def _has_drop(self, edge: Edge) -> bool:
        return all(self.node(name) is not None for name in self.drop(edge).values())

    def _missing(self, edge: Edge) -> str:
        names = [f"Q{edge.line}", *self.drop(edge).values()]
        return ", ".join(name for name in names if self.node(name) is None)


def check_each_once(nodes: Mapping[str, str | None]) -> None:
    """Refuse two signals with the same node.

    Raises
    ------
    ValueError
        naming both.
    """
    names: dict[str, str] = {}
    for name, node in nodes.items():
        if node is not None and names.setdefault(node, name) != name:
            raise ValueError(f"{names[node]} and {name} are the same node, '{node}'")


def node_id(text: str) -> str:
    """Return the text of a node id.

    Raises
    ------
    ValueError
        if it does not look like one.
    """
    if any(kind in f";{text}" for kind in (";s=", ";i=", ";g=", ";b=")):
        return text
    raise ValueError(
        "a node id looks like nsu=URI;s=NAME, ns=2;s=NAME or ns=2;i=85; an element of an array "
        "like index=3;ns=2;s=NAME, a member of a structure like member=In.Pressure;ns=2;s=NAME"
    )
