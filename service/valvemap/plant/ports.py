"""Valves with four ports: all their edges from the labels of ports, or one edge."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from valvemap.plant import evidence
from valvemap.plant.candidates import Candidate
from valvemap.plant.grouping import Group
from valvemap.plant.law import Fit, fit
from valvemap.plant.reading import Given, Reading, Record
from valvemap.plant.roles import Role
from valvemap.plant.scales import Scale, scales
from valvemap.vocabulary.edges import Edge

NAMES: Final[Mapping[Role, str]] = {
    Role.U: "U", Role.P1: "pP", Role.P2: "pT", Role.PA: "pA", Role.PB: "pB", Role.Q: "QA",
    Role.QB: "QB", Role.T: "T",
}  # fmt: skip
"""What the signals of a valve with ports are called in the configuration."""
_ROLE: Final = {name: role for role, name in NAMES.items()}
REQUIRED: Final = (Role.U, Role.P1, Role.P2, Role.PA, Role.PB, Role.Q)
AGAINST: Final = 0.2  # share of the samples of an edge that flow against its pressures
_EXPLAINED: Final = 0.5  # of the variance of an edge's flow, at least
_LEAVES: Final = -2.0  # nats


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
    if not set(REQUIRED) <= set(nodes):
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
        if own.reversed_share > AGAINST:
            yield f"Q{edge.line} flows against the pressures while {edge} is open"
        elif own.moves and own.explained < _EXPLAINED:
            yield f"Q{edge.line} does not follow U and the pressures while {edge} is open"


def physics_of(edge: Edge, law: Fit) -> str:
    """Return what the law says of an edge's flow, as seen."""
    line = f"Q{edge.line}"
    if not law.moves:
        return f"not checked: {line} did not move while {edge} was open"
    return f"the orifice law explains {100 * law.explained:.0f} % of {line} while {edge} is open"
