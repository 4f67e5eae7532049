"""Questions about the readings of a valve: what remains, with consequences and answers."""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from valvemap.foreign_text import printable
from valvemap.plant import evidence
from valvemap.plant.candidates import Candidate
from valvemap.plant.concepts import SIDES
from valvemap.plant.evidence import Rating
from valvemap.plant.grouping import Group
from valvemap.plant.questions import Option, Question
from valvemap.plant.reading import Given, Reading, Record
from valvemap.plant.readings import readings
from valvemap.plant.roles import QUANTITY, Role

_NAMED: Final = 0.02  # probability of a reading that a question names
_LEAST_NAMED, _MOST_NAMED = 2, 12
_CLEAR: Final = -2.0  # nats; a contradiction that is named
_NEED_A_UNIT: Final = frozenset(
    {Role.U, Role.P1, Role.P2, Role.DP, Role.PA, Role.PB, Role.Q, Role.QB}
)
_LETTER: Final = re.compile(r"[^\W\d_]")  # "-" and "1/1" state no unit
_NAMED_INSTEAD: Final = frozenset({Role.SPOOL, Role.POSITION, Role.PILOT})


def question_of_readings(valve: str, found: Sequence[Reading]) -> Question:
    """Ask with the readings that remain, and the one by labels."""
    whole = [r for r in found if not r.missing]
    near = [r for r in whole if r.probability > _NAMED][:_MOST_NAMED]
    near = near if len(near) >= _LEAST_NAMED else whole[:_LEAST_NAMED]
    if _differing(near) == [Role.Q] and _is_of_unit_alone(near):  # name each unit of the flow
        near += [r for r in whole if r not in near and _differing([near[0], r]) == [Role.Q]
                 and _is_of_unit_alone([near[0], r])]  # fmt: skip
    labelled = [r for r in found if not (r.mistake or r.missing or r.beside)][:1]
    shown = list(dict.fromkeys([r.key for r in (*near, *labelled)]))
    by_key = {r.key: r for r in found}
    return _question(valve, [by_key[key] for key in shown], found, found[0])


def in_foreign_units(best: Reading, given: Given) -> tuple[Role, ...]:
    """Roles whose unit is taken for the usual one, though their nodes state another."""
    return tuple(
        role
        for role in best.assumed
        if role in _NEED_A_UNIT and role not in given.scales and _foreign_unit(best, role)
    )


def question_of_units(valve: str, best: Reading, roles: Sequence[Role]) -> Question:
    """Ask for units of which no conversion is known."""
    about = "; ".join(_foreign_unit(best, role) for role in roles)
    return Question(about, (_option(valve, best, roles),))


def _foreign_unit(reading: Reading, role: Role) -> str:
    """Say that a node states a unit that is none of its quantity; empty where it does not."""
    noun, node = QUANTITY[role].noun, reading.nodes.get(role)
    is_stated = node is not None and _LETTER.search(node.symbol) is not None
    if not noun or node is None or not is_stated or node.label.units:
        return ""
    article = "an" if noun[0] in "aeiou" else "a"
    return f"{role} in {printable(node.symbol)!r}, which is no unit of {article} {noun}"


def question_of_missing(group: Group, best: Reading, record: Record, rating: Rating) -> Question:
    """Name the missing signals, and those present; of a single one with its readings."""
    parts = []
    for role in best.missing:
        instead = [
            f"{printable(one.node)} is its {one.label.role}"
            for one in group.all
            if one.node not in {n.node for n in best.nodes.values()}
            and (one.label.evidence[role] > 0.0 or one.label.role in _NAMED_INSTEAD)
        ]
        instead += [
            f"{printable(one.node)} {as_text(one)}"
            for one in group.texts
            if one.label.evidence[role] > 0.0
        ]
        there = f" ({'; '.join(instead[-3:])})" if instead else ""
        parts.append(f"{role}: no node was found{there}")
    options: list[Option] = []
    if len(best.missing) == 1:
        options += _instead(group, best, record, rating)
        options += _as_difference(group, best, record, rating)
    return Question("; ".join(parts), tuple(options))


def question_of_references(valve: str, role: Role, found: Sequence[Reading]) -> Question:
    """Ask whether a pressure is absolute, as the other one is, or is not."""
    about = (
        f"{role}: against the atmosphere, or absolute? p1 and p2 seem to differ in that by 1 bar"
    )
    return Question(about, tuple(_option(valve, one, [role]) for one in found))


def as_text(one: Candidate) -> str:
    """Return what to do about a variable that sends its number as a text."""
    return f"sends a text, {printable(one.text)!r}: publish its number, as REAL or INT"


def question_of_meters(valve: str, best: Reading, other: Reading) -> Question:
    """Ask which of two meters that move alike is the valve's."""
    names = [printable(one.nodes[Role.Q].path[-1]) for one in (best, other)]
    about = f"Q: {' and '.join(names)} move alike and are not equal; the values do not say which"
    return Question(about, tuple(_option(valve, one, [Role.Q]) for one in (best, other)))


def question_of_possible(valve: str, found: Sequence[Sequence[Reading]]) -> Question:
    """Ask whether variables are a valve's whose names do not say so; readings by assignment."""
    about = "by units and values these may be a valve's signals, which no name says"
    likely = [one for own in found for one in own if one is own[0] or one.probability > _NAMED]
    options = (_option(valve, one, list(one.nodes)) for one in likely[:_MOST_NAMED])
    named = tuple(replace(o, text=o.text.partition(": ")[2]) for o in options)
    return Question(about, named, _other_spans(valve, likely[0]))


def question_of_one_meter(group: Group, best: Reading) -> Question:
    """Ask about a meter that measures several valves together."""
    valves = ", ".join(group.one_meter)
    about = f"Q: one meter for the valves {valves}, whose flows add up in it"
    consequence = (
        "answered for each of them, all are learnt together; a valve that is left out (--skip) "
        "must stay shut"
    )
    answers = tuple(a for role in best.nodes for a in _answers(group.name, role, best))
    own = Option("Q is the sum of their flows", consequence, answers, best.probability)
    return Question(about, (own,))


def _consequence_of(reading: Reading) -> str:
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
    said += [f"but {name}" for name in _against(reading)]
    return ", ".join(said) or "no values were seen"


def _question(
    valve: str, options: Sequence[Reading], found: Sequence[Reading], best: Reading
) -> Question:
    differing = _differing(options)
    what = ", ".join(differing) or "its signals"
    left = 1.0 - sum(r.probability for r in found)
    against = _against(best)
    foreign = [said for role in differing if (said := _foreign_unit(best, role))]
    by_labels = _differing([r for r in options if not r.mistake])
    unstated = [
        role
        for role in by_labels
        if role in best.assumed and len({_node_of(r, role) for r in options}) == 1
    ]
    if any(r.beside for r in options) and not best.mistake:
        about = f"Q: its meter may measure {_others(options)}, too, which has none of its own"
    elif foreign:
        about = "; ".join(foreign)
    elif unstated and unstated == by_labels and not best.mistake:
        differing = [role for role in Role if role in unstated or role in _guessed_spans(best)]
        about = f"{', '.join(differing)}: nothing states the unit"
    elif best.mistake:
        about = f"{what}: the values contradict the labels"
    elif against:
        about = f"{', '.join(against)}: its unit, its range or the node is wrong"
    elif differing == [Role.Q] and _is_of_unit_alone(options):
        about = "Q: its unit is stated, but valves of the size that follows from it are less usual"
    elif left > 0.2 and best.fit.moves:
        about = f"{what}: Q does not follow U and the pressures as the flow of an orifice would"
    else:
        about = f"{what}: ambiguous"
    named = tuple(_option(valve, r, differing or list(r.nodes)) for r in options)
    return Question(about, named, _other_spans(valve, best))


def _other_spans(valve: str, best: Reading) -> tuple[str, ...]:
    """Return the answers for sensors of other spans than the usual ones, to be completed."""
    return tuple(
        f"--scale={valve}.{role}={low:g}..{high:g}:LEAST..MOST{QUANTITY[role].value}"
        for role, (low, high) in _guessed_spans(best).items()
    )


def _guessed_spans(reading: Reading) -> dict[Role, tuple[float, float]]:
    """Return the raw spans of sensors whose full scale is only a usual one."""
    raw = {role: reading.scales[role].measure.raw for role in reading.assumed}
    return {role: span for role, span in raw.items() if span is not None and role is not Role.U}


def _is_of_unit_alone(options: Sequence[Reading]) -> bool:
    """Whether the readings name one meter in several units of flow, one of them as it is stated."""
    nodes = {reading.nodes[Role.Q].node for reading in options}
    return len(nodes) == 1 and any(r.scales[Role.Q].stated or r.mistake for r in options)


def _against(reading: Reading) -> tuple[str, ...]:
    return tuple(name for name, nats in reading.contradictions.items() if nats < _CLEAR)


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
        consequence = f"{_consequence_of(reading)}; its own flow is not measured: leave it out"
        return Option(together, consequence, (f"--skip={valve}",), reading.probability)
    shown = [
        _shown(role, reading) if role in reading.nodes else f"without {role}" for role in differing
    ]
    answers = [a for role in reading.nodes for a in _answers(valve, role, reading)]
    return Option(
        f"{text}: {', '.join(shown)}",
        _consequence_of(reading),
        tuple(answers),
        reading.probability,
        reading.fit.explained,
        _against(reading),
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


def _as_difference(group: Group, best: Reading, record: Record, rating: Rating) -> Iterator[Option]:
    """Yield the reading in which the only pressure is that of a transmitter of Δp."""
    pressures = {Role.P1, Role.P2}
    alone = pressures & set(best.nodes)
    if not set(best.missing) <= pressures or len(alone) != 1:
        return
    (side,) = alone
    if SIDES.intersection(best.nodes[side].label.concepts):
        return  # its name says on which side of the valve it is
    kept = {role: node.node for role, node in best.nodes.items() if role is not side}
    found = readings(group, record, Given({**kept, Role.DP: best.nodes[side].node}), rating)
    if found and not found[0].missing:
        yield _option(group.name, found[0], [Role.DP])


def _instead(group: Group, best: Reading, record: Record, rating: Rating) -> Iterator[Option]:
    """Yield the readings in which another variable takes the place of the missing signal."""
    (role,) = best.missing
    taken = {node.node for node in best.nodes.values()}
    for one in [one for one in group.all if one.node not in taken][:_MOST_NAMED]:
        quantities = {unit.quantity for unit in one.label.units}
        if not quantities and not one.symbol and one.label.role in QUANTITY:
            quantities = {QUANTITY[one.label.role]}
        if QUANTITY[role] not in quantities:
            continue
        kept = {own: node.node for own, node in best.nodes.items()}
        found = readings(group, record, Given({**kept, role: one.node}), rating)
        if found and not found[0].missing:
            yield replace(
                _option(group.name, found[0], [role]),
                text=f"{role} = {printable(one.node)}, its {one.label.role}",
            )
