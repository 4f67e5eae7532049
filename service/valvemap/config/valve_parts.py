"""A valve with ports as the valves that stand for it: its lines and edges."""

from collections.abc import Mapping
from typing import Any

from valvemap.config.estimators import AutoConfig
from valvemap.config.ports import PortsConfig
from valvemap.config.valves import NodesConfig, ValveConfig
from valvemap.vocabulary.edges import Edge


class EdgeConfig(ValveConfig):
    """One edge of a valve with ports; made from that valve, never read from a file."""

    valve: str = ""
    edge: Edge = Edge.PA
    called: Mapping[str, str] = {}  # its signals by the names that they have among ports


class LineConfig(ValveConfig):
    """One line of a valve with ports; made from that valve, never read from a file."""

    valve: str = ""
    line: str = "A"
    closed_percent: float = 3.0
    called: Mapping[str, str] = {}  # as of an edge
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
        most, flow = valve.dp_range_bar[1], max(map(abs, valve.Q_range_l_min))
        bounds = {
            "U_range_percent": (low, high),
            "dp_range_bar": (-most, most),
            "Q_range_l_min": (-flow, flow),
        }
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
                called=_called(ports, signals),
                closed_percent=ports.closed_percent,
                not_learnt=left_out if not found else (),
            )
        )
    for edge in edges:
        head = {"name": f"{valve.name}.{edge}", "valve": valve.name, "edge": edge}
        bounds = {"U_range_percent": (0.0, high if edge.opens > 0 else -low)}
        signals = {**ports.drop(edge), "Q": f"Q{edge.line}"}
        named = _called(ports, signals)
        parts = _of_part(ports, signals)
        found.append(_made(EdgeConfig, valve, **head, **bounds, **parts, called=named))
    return tuple(found)


def _made(kind: type[ValveConfig], whole: ValveConfig, /, **own: Any) -> ValveConfig:  # noqa: ANN401
    """Return a part of a valve: its name is not one that a file may have."""
    given = {name: getattr(whole, name) for name in ValveConfig.model_fields if name != "ports"}
    return kind.model_construct(**(given | own))


def _of_part(ports: PortsConfig, signals: dict[str, str]) -> dict[str, Any]:
    """Return nodes and signals of an edge or line, from the names that they have among ports."""
    named = _called(ports, signals)
    nodes = {signal: ports.node(name) for signal, name in named.items()}
    return {
        "nodes": NodesConfig(**nodes, sequence=ports.sequence),
        "signals": ports.signals.of(**named),
    }


def _called(ports: PortsConfig, signals: dict[str, str]) -> dict[str, str]:
    """Return the names among ports of all signals of an edge or line."""
    return {"U": "U", **signals} | ({} if ports.T is None else {"T": "T"})
