"""Valves with four ports: all their edges from the labels of ports, or one edge."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from valvemap.foreign_text import printable
from valvemap.plant import evidence
from valvemap.plant.candidates import Candidate
from valvemap.plant.grouping import Group
from valvemap.plant.law import Fit, fit
from valvemap.plant.questions import Option, Question
from valvemap.plant.reading import Given, Reading, Record
from valvemap.plant.roles import QUANTITY, Role
from valvemap.plant.scales import Scale, reversed_command, scales
from valvemap.vocabulary.edges import Edge

NAMES: Final[Mapping[Role, str]] = {
    Role.U: "U", Role.P1: "pP", Role.P2: "pT", Role.PA: "pA", Role.PB: "pB", Role.Q: "QA",
    Role.QB: "QB", Role.T: "T",
}  # fmt: skip
"""What the signals of a valve with ports are called in the configuration."""
_ROLE: Final = {name: role for role, name in NAMES.items()}
_REQUIRED: Final = (Role.U, Role.P1, Role.P2, Role.PA, Role.PB, Role.Q)
_AGAINST: Final = 0.2  # share of the samples of an edge that flow against its pressures
_EXPLAINED: Final = 0.5  # of the variance of an edge's flow, at least
_LEAVES: Final = -2.0  # nats
_MOST_NAMED: Final = 12  # nodes of a question


@dataclass(frozen=True)
class Edges:
    """All edges of a valve: its signals, the law's fit of each edge, and what contradicts it."""

    reading: Reading
    fits: Mapping[Edge, Fit]
    faults: tuple[str, ...]


def is_directional(group: Group) -> bool:
    """Whether it has four ports: pressures at P, T, A and B."""
    roles = {one.label.role for one in group.all}
    return {Role.PA, Role.PB, Role.P1, Role.P2} <= roles


def one_direction(group: Group, record: Record, given: Given) -> Record:
    """Return the values at U > 0 of a valve with four ports."""
    if not is_directional(group):
        return record
    commands = [one for one in group.all if one.node == given.nodes.get(Role.U)]
    if not commands:
        return record
    scale = given.scales.get(Role.U)
    U = record.of(commands[0])
    U = scale(U, Role.U) if scale is not None else U
    kept = {
        node: np.where(U > 0.0, values, np.nan)
        for node, values in record.values.items()
        if len(values) == len(U)
    }
    return Record(kept, record.step_s)


def edges_of(group: Group, record: Record, given: Given) -> Edges | None:
    """Return the edges by the labels of the ports; None if a required signal is missing."""
    nodes: dict[Role, Candidate] = {}
    for one in sorted(group.all, key=lambda one: one.label.evidence[one.label.role]):
        if one.label.role in NAMES:
            nodes[one.label.role] = one
    answered = {one.node: one for one in group.all if one.node in given.nodes.values()}
    nodes = {role: one for role, one in nodes.items() if one.node not in answered}
    nodes |= {role: answered[node] for role, node in given.nodes.items() if role in NAMES}
    if not set(_REQUIRED) <= set(nodes):
        return None
    nodes = {role: nodes[role] for role in NAMES if role in nodes}
    chosen = {role: _scale(role, node, record, given) for role, node in nodes.items()}
    values = {role: chosen[role](record.of(node), role) for role, node in nodes.items()}
    fits = {
        edge: _fit(edge, values, record.step_s) for edge in Edge if _ROLE[f"Q{edge.line}"] in nodes
    }
    tested = [one for one in fits.values() if one.moves]
    weakest = min(tested, key=lambda one: one.explained, default=next(iter(fits.values())))
    reading = Reading(nodes, chosen, 0.0, weakest, values=values, probability=0.5)
    return Edges(reading, fits, tuple(_faults(reading, fits, record, group, given)))


def question_of_missing(group: Group, given: Given) -> Question:
    """Ask for the nodes of ports that nothing names; the valve's other numbers may be them."""
    others = [one for one in group.all if one.node not in given.nodes.values()]
    labels = [one.label.role for one in others]
    missing = [NAMES[r] for r in _REQUIRED if r not in labels and r not in given.nodes]
    left = [
        printable(one.node)
        for one, role in zip(others, labels, strict=True)
        if role not in NAMES or labels.count(role) > 1
    ]
    answers = " ".join(f"--signal={group.name}.{name}=NODE" for name in missing)
    beside = f"; it also has {', '.join(left[:_MOST_NAMED])}" if left else ""
    return Question(f"{', '.join(missing)}: no node was found: {answers}{beside}")


def _scale(role: Role, node: Candidate, record: Record, given: Given) -> Scale:
    own = given.scales.get(role)
    return own or scales(node, role, record.of(node), assume=given.assume)[0]


def _fit(edge: Edge, values: Mapping[Role, np.ndarray], step_s: float) -> Fit:
    """Test the law on the samples at which the edge is open."""
    U, Q = values[Role.U], edge.adds * values[_ROLE[f"Q{edge.line}"]]
    dp = values[_ROLE[f"p{edge.of}"]] - values[_ROLE[f"p{edge.to}"]]
    opened = edge.opens * U > 0.0
    return fit(np.abs(U), dp, np.where(opened, Q, np.nan), step_s)


def _faults(
    reading: Reading, fits: Mapping[Edge, Fit], record: Record, group: Group, given: Given
) -> Iterator[str]:
    for role, node in reading.nodes.items():
        if not reading.scales[role].stated:
            yield f"{NAMES[role]}: nothing states the unit"
        outside = evidence.of_range(record.of(node), node.bounds, role) < _LEAVES
        if outside and role not in given.scales:
            yield f"{NAMES[role]} leaves its range"
        if role not in given.nodes and sum(one.label.role is role for one in group.all) > 1:
            yield f"{NAMES[role]}: several nodes have this name"
    for edge, own in fits.items():
        if own.reversed_share > _AGAINST:
            yield f"Q{edge.line} flows against the pressures while {edge} is open"
        elif own.moves and own.explained < _EXPLAINED:
            yield f"Q{edge.line} does not follow U and the pressures while {edge} is open"


def physics_of(edge: Edge, law: Fit) -> str:
    """Return what the law says of an edge's flow, as seen."""
    line = f"Q{edge.line}"
    if not law.moves:
        return f"not checked: {line} did not move while {edge} was open"
    return f"the orifice law explains {100 * law.explained:.0f} % of {line} while {edge} is open"


def question_of_faults(group: Group, record: Record, found: Edges, given: Given) -> Question:
    """Ask with what contradicts the labels, and the readings of all edges without contradiction."""
    return Question("; ".join(found.faults), tuple(_corrected(group, record, found, given)))


def _corrected(group: Group, record: Record, found: Edges, given: Given) -> Iterator[Option]:
    """Yield the readings that nothing contradicts once they are answered."""
    nodes, own = found.reading.nodes, found.reading.scales
    readings = {"as labelled": (nodes, own)}
    if Role.U not in given.scales:
        U = reversed_command(own[Role.U], np.array([-1.0, 1.0]))
        readings["U > 0 opens PB and AT"] = nodes, {**own, Role.U: U}
    if Role.QB in nodes and not {Role.Q, Role.QB} <= set(given.nodes):
        changed = {Role.Q: Role.QB, Role.QB: Role.Q}
        readings["QA and QB are exchanged"] = (
            {role: nodes[changed.get(role, role)] for role in nodes},
            {role: own[changed.get(role, role)] for role in nodes},
        )
    for text, (named, scaled) in readings.items():
        answered = {role: replace(scale, stated=True) for role, scale in scaled.items()}
        whole = Given({role: one.node for role, one in named.items()}, answered, ports=True)
        edges = edges_of(group, record, whole)
        if edges is not None and not edges.faults:
            answers = [a for role in named for a in _answers_of(group.name, role, edges.reading)]
            seen = ", ".join(_seen(role, edges.reading) for role in named)
            yield Option(
                f"{text}: {_all(edges)}", f"{seen}; {_explained(edges)}",
                (f"--ports={group.name}", *answers), 0.5,
            )  # fmt: skip


def _answers_of(valve: str, role: Role, reading: Reading) -> tuple[str, str]:
    name, unit = NAMES[role], reading.scales[role].text or QUANTITY[role].value
    return (
        f"--signal={valve}.{name}={reading.nodes[role].node}",
        f"--scale={valve}.{name}={unit}",
    )


def _seen(role: Role, reading: Reading) -> str:
    good = reading.values[role][np.isfinite(reading.values[role])]
    seen = f"{good.min():.3g} … {good.max():.3g}" if len(good) else "no value of"
    name = printable(reading.nodes[role].path[-1])
    return f"{NAMES[role]} ({name}) {seen} {QUANTITY[role].value}"


def _all(found: Edges) -> str:
    lines = "both lines" if Role.QB in found.reading.nodes else "line A"
    return f"all edges: {', '.join(found.fits)}, with the leakage of {lines}"


def _explained(found: Edges) -> str:
    said = [
        f"the orifice law explains {100 * own.explained:.0f} % of the flow of {edge}"
        for edge, own in found.fits.items()
        if own.moves
    ]
    return "; ".join([*said, "a map of each edge ([valves.ports])"])


def question_of_ports(
    group: Group, record: Record, found: Edges, base: Reading, given: Given
) -> Question:
    """Ask whether all edges are to be learnt, or one of them."""
    options: list[Option] = []
    port = {one.label.role: one for one in group.all}
    if found.faults:
        options += _corrected(group, record, found, given)
    else:
        options.append(Option(_all(found), _explained(found), (f"--ports={group.name}",), 0.5))
    for role, meter, sign in ((Role.PA, Role.Q, 1), (Role.PB, Role.QB, -1)):
        flow = port.get(meter)
        if flow is not None:
            options.append(_edge(group.name, base, port[role], flow, record, sign))
    about = "it has four ports (P, T, A, B), U works both ways: all edges, or the map of one"
    if found.faults:
        about = f"{about}; not all, because {'; '.join(found.faults)}"
    return Question(about, tuple(options))


def _edge(
    valve: str, base: Reading, port: Candidate, flow: Candidate, record: Record, sign: int
) -> Option:
    """Return the edge from P to a port as an option; for the other direction U is reversed."""
    own = base.scales[Role.U]
    measure = own.measure
    (low, high), (least, most) = measure.raw or (-100.0, 100.0), measure.scaled or (-100.0, 100.0)
    if sign < 0:
        least, most = -least, -most
    U_scale = Scale(replace(measure, raw=(low, high), scaled=(least, most)), 0.0, "")
    pressure = base.scales.get(Role.P1) or own
    flow_units = [unit for unit in flow.label.units if unit.quantity is QUANTITY[Role.Q]]
    Q_unit = flow_units[0].symbol if flow_units else "l/min"
    U = U_scale(record.of(base.nodes[Role.U]), Role.U)
    p1, p2 = (pressure(record.of(one), Role.P1) for one in (base.nodes[Role.P1], port))
    tested = ""
    Q = record.of(flow)
    if len(U) == len(p1) == len(p2) == len(Q):
        ahead = np.where(U > 0.0, Q, np.nan)
        law = fit(U, p1 - p2, ahead, record.step_s)
        if law.moves:
            tested = f"the orifice law explains {100 * law.explained:.0f} % of the flow there; "
    edge = "PA" if sign > 0 else "PB"
    answers = (
        f"--signal={valve}.U={base.nodes[Role.U].node}", f"--scale={valve}.U={U_scale.text}",
        f"--signal={valve}.p1={base.nodes[Role.P1].node}",
        f"--scale={valve}.p1={pressure.text or 'bar'}",
        f"--signal={valve}.p2={port.node}", f"--scale={valve}.p2={pressure.text or 'bar'}",
        f"--signal={valve}.Q={flow.node}", f"--scale={valve}.Q={Q_unit}",
    )  # fmt: skip
    consequence = f"{tested}samples of the other direction are not learnt (gate.U.low = 0)"
    return Option(f"edge {edge}: p1 = pP, p2 = p{edge[1]}", consequence, answers, 0.5)
