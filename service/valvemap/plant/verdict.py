"""Decides on a valve: accepts the likeliest reading, or asks with the readings that remain."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from valvemap.foreign_text import printable
from valvemap.plant import evidence
from valvemap.plant.candidates import Candidate
from valvemap.plant.evidence import Rating
from valvemap.plant.grouping import Group
from valvemap.plant.law import fit
from valvemap.plant.reading import Given, Reading, Record
from valvemap.plant.readings import readings
from valvemap.plant.roles import QUANTITY, Role
from valvemap.plant.scales import Scale

ACCEPTED: Final = 0.95  # probability of a reading that is taken without a question
_NAMED: Final = 0.02  # probability of a reading that a question names
_MOST_NAMED: Final = 4
_CLEAR: Final = -2.0  # nats; a contradiction that is named
_NAMED_INSTEAD: Final = frozenset({Role.SPOOL, Role.POSITION, Role.PILOT})


@dataclass(frozen=True)
class Option:
    """One reading of a question: what it is, its consequence, and the answers that choose it."""

    text: str
    consequence: str
    answers: tuple[str, ...]
    probability: float


@dataclass(frozen=True)
class Question:
    """An open point of one valve; without options nothing can be chosen."""

    about: str
    options: tuple[Option, ...] = ()


@dataclass(frozen=True)
class Verdict:
    """The result for one valve. ``reading`` is to be configured only if ``question`` is None.

    ``others`` are signals recognised as none of the map's, by node; ``least_U`` is set where only
    one direction can be learnt.
    """

    valve: str
    reading: Reading | None
    question: Question | None
    others: Mapping[str, Role]
    least_U: float | None = None

    @property
    def probability(self) -> float:
        """Probability of the reading."""
        return 0.0 if self.reading is None else self.reading.probability


def judge(
    group: Group,
    record: Record,
    given: Given | None = None,
    rating: Rating | None = None,
) -> Verdict:
    """Judge one valve's variables by labels and values."""
    given, rating = given or Given(), rating or Rating()
    others = {one.node: one.label.role for one in group.all if not one.label.is_relevant}
    edges = _edges(group, record, given, rating)
    if edges is not None:
        return replace(edges, others=others)
    found = readings(group, _one_direction(group, record, given), given, rating)
    if not found:
        return Verdict(group.name, None, Question("no reading of its signals fits"), others)
    best = found[0]
    least_U = 0.0 if _is_directional(group) else None
    if group.one_meter and Role.Q not in given.nodes and Role.Q in best.nodes:
        return Verdict(group.name, best, _one_meter(group, best), others, least_U)
    if best.missing:
        return Verdict(group.name, best, _missing(group, best), others)
    if best.probability >= ACCEPTED and not best.mistake and not best.beside:
        return Verdict(group.name, best, None, others, least_U)
    near = [r for r in found if r.probability > _NAMED and not r.missing][:_MOST_NAMED]
    labelled = [r for r in found if not (r.mistake or r.missing or r.beside)][:1]
    shown = list(dict.fromkeys([r.key for r in (*near, *labelled)]))
    by_key = {r.key: r for r in found}
    options = [by_key[key] for key in shown]
    return Verdict(group.name, best, _question(group.name, options, found, best), others, least_U)


def _question(
    valve: str, options: Sequence[Reading], found: Sequence[Reading], best: Reading
) -> Question:
    differing = _differing(options)
    what = ", ".join(differing) or "its signals"
    left = 1.0 - sum(r.probability for r in found)
    against = [name for name, nats in best.contradictions.items() if nats < _CLEAR]
    foreign = [
        f"{role} in {printable(best.nodes[role].symbol)!r}, which is no unit of a {noun}"
        for role in differing
        if (noun := QUANTITY[role].noun)
        and role in best.nodes
        and best.nodes[role].symbol
        and not best.nodes[role].label.units
    ]
    unstated = [
        role
        for role in differing
        if role in best.assumed and len({_node_of(r, role) for r in options}) == 1
    ]
    if any(r.beside for r in options) and not best.mistake:
        about = f"Q: its meter may measure {_others(options)}, too, which has none of its own"
    elif foreign:
        about = "; ".join(foreign)
    elif unstated and unstated == differing and not best.mistake:
        about = f"{what}: nothing states the unit"
    elif best.mistake:
        about = f"{what}: the values contradict the labels"
    elif against:
        about = f"{', '.join(against)}: its unit, its range or the node is wrong"
    elif left > 0.2 and best.fit.moves:
        about = f"{what}: Q does not follow U and the pressures as the flow of an orifice would"
    else:
        about = f"{what}: ambiguous"
    return Question(about, tuple(_option(valve, r, differing or list(r.nodes)) for r in options))


def _others(options: Iterable[Reading]) -> str:
    return ", ".join(dict.fromkeys(name for r in options for name in r.beside))


def _differing(options: Sequence[Reading]) -> list[Role]:
    roles = [role for role in Role if any(role in r.nodes for r in options)]
    return [role for role in roles if len({_of_role(r, role) for r in options}) > 1]


def _node_of(reading: Reading, role: Role) -> str | None:
    return reading.nodes[role].node if role in reading.nodes else None


def _of_role(reading: Reading, role: Role) -> tuple[str, str] | None:
    if role not in reading.nodes:
        return None
    return reading.nodes[role].node, reading.scales[role].text


def _option(valve: str, reading: Reading, differing: Sequence[Role]) -> Option:
    text = reading.mistake or "as labelled"
    if reading.beside:
        together = f"its meter measures {_others([reading])}, too"
        consequence = f"{consequence_of(reading)}; its own flow is not measured: leave it out"
        return Option(together, consequence, (f"--skip={valve}",), reading.probability)
    shown = [_shown(role, reading) for role in differing if role in reading.nodes]
    answers = [a for role in reading.nodes for a in _answers(valve, role, reading)]
    return Option(
        f"{text}: {', '.join(shown)}", consequence_of(reading), tuple(answers), reading.probability
    )


def _shown(role: Role, reading: Reading) -> str:
    node, scale = reading.nodes[role], reading.scales[role]
    unit = scale.text or QUANTITY[role].value
    return f"{role} = {printable(node.node)} in {unit}"


def _answers(valve: str, role: Role, reading: Reading) -> list[str]:
    scale = reading.scales[role].text or QUANTITY[role].value
    return [
        f"--signal={valve}.{role}={reading.nodes[role].node}",
        f"--scale={valve}.{role}={scale}",
    ]


def consequence_of(reading: Reading) -> str:
    """Return what a reading means for the values: pressures, flow, coefficient, the law's fit."""
    values = reading.values
    said = []
    for role in (Role.P1, Role.P2, Role.DP, Role.Q, Role.U):
        good = values[role][np.isfinite(values[role])] if role in values else np.zeros(0)
        if len(good):
            unit = QUANTITY[role].value
            said.append(f"{role} {good.min():.3g} … {good.max():.3g} {unit}")
    if {Role.U, Role.Q} <= set(values) and ({Role.P1, Role.P2} <= set(values) or Role.DP in values):
        said.append(f"Q/√dp up to {evidence.coefficient(values):.3g} l/min/√bar")
    if reading.fit.moves:
        said.append(f"the orifice law explains {100 * reading.fit.explained:.0f} % of Q")
    said += [f"but {name}" for name, nats in reading.contradictions.items() if nats < _CLEAR]
    return ", ".join(said) or "no values were seen"


def _missing(group: Group, best: Reading) -> Question:
    """Name the missing signals, and what there is instead."""
    parts = []
    for role in best.missing:
        instead = [
            f"{printable(one.node)} is its {one.label.role}"
            for one in group.all
            if one.node not in {n.node for n in best.nodes.values()}
            and (one.label.evidence[role] > 0.0 or one.label.role in _NAMED_INSTEAD)
        ]
        there = f" ({'; '.join(instead[:3])})" if instead else ""
        parts.append(f"{role}: no node was found{there}")
    return Question("; ".join(parts))


def _one_meter(group: Group, best: Reading) -> Question:
    """Ask about a meter that measures several valves together."""
    valves = ", ".join(group.one_meter)
    about = f"Q: one meter for the valves {valves}, whose flows add up in it"
    consequence = "right only if the other valves stay shut, or have another meter"
    answers = tuple(a for role in best.nodes for a in _answers(group.name, role, best))
    own = Option("it measures this valve alone", consequence, answers, best.probability)
    return Question(about, (own,))


def _is_directional(group: Group) -> bool:
    """Whether it has four ports: pressures at P, T, A and B."""
    roles = {one.label.role for one in group.all}
    return {Role.PA, Role.PB, Role.P1, Role.P2} <= roles


def _one_direction(group: Group, record: Record, given: Given) -> Record:
    """Return the values at U > 0 of a valve with four ports."""
    if not _is_directional(group):
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


def _edges(group: Group, record: Record, given: Given, rating: Rating) -> Verdict | None:
    """Ask which edge of a valve with four ports is meant; None if it has not, or it is answered."""
    if not _is_directional(group) or {Role.P1, Role.P2} <= set(given.nodes):
        return None
    port = {one.label.role: one for one in group.all}
    if Role.U not in port:
        return None
    options = []
    whole = readings(
        Group(
            group.name, tuple(one for one in group.all if one.label.role not in {Role.PA, Role.PB})
        ),
        record,
        given,
        rating,
    )
    base = whole[0] if whole else None
    if base is None or Role.U not in base.nodes:
        return None
    for role, meter, sign in ((Role.PA, Role.Q, 1), (Role.PB, Role.QB, -1)):
        flow = port.get(meter)
        if flow is None:
            continue
        options.append(_edge(group.name, base, port[role], flow, record, sign))
    about = (
        "it has four ports (P, T, A, B), U works both ways: one map describes one edge of it, and "
        "the other direction is left out"
    )
    return Verdict(group.name, base, Question(about, tuple(options)), {}, 0.0)


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
