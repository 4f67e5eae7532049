"""Questions about valves with four ports: nodes that are missing, and readings that fit."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from valvemap.foreign_text import printable
from valvemap.plant.grouping import Group
from valvemap.plant.mistaken_scales import reversed_command
from valvemap.plant.ports import AGAINST, NAMES, REQUIRED, Edges, edges_of
from valvemap.plant.questions import Option, Question
from valvemap.plant.reading import Given, Reading, Record
from valvemap.plant.roles import QUANTITY, Role
from valvemap.plant.scales import Scale
from valvemap.vocabulary.edges import Edge

_MOST_NAMED: Final = 12  # nodes of a question
_EDGES: Final = ((Edge.PA, Role.PA, Role.Q), (Edge.PB, Role.PB, Role.QB))
"""Edges that may be learnt alone, with the pressure and the meter of their line."""


def question_of_missing(group: Group, given: Given) -> Question:
    """Ask for the nodes of ports that nothing names; the valve's other numbers may be them."""
    others = [one for one in group.all if one.node not in given.nodes.values()]
    labels = [one.label.role for one in others]
    missing = [NAMES[r] for r in REQUIRED if r not in labels and r not in given.nodes]
    left = [
        printable(one.node)
        for one, role in zip(others, labels, strict=True)
        if role not in NAMES or labels.count(role) > 1
    ]
    answers = " ".join(f"--signal={group.name}.{name}=NODE" for name in missing)
    beside = f"; it also has {', '.join(left[:_MOST_NAMED])}" if left else ""
    return Question(f"{', '.join(missing)}: no node was found: {answers}{beside}")


def question_of_faults(group: Group, record: Record, found: Edges, given: Given) -> Question:
    """Ask with what contradicts the labels, and the readings of all edges without contradiction."""
    options = [
        _whole(group.name, text, edges)
        for text, edges in corrected(group, record, found, given).items()
    ]
    return Question("; ".join(found.faults), tuple(options))


def question_of_ports(group: Group, record: Record, found: Edges, given: Given) -> Question:
    """Ask whether all edges are to be learnt, or one of them."""
    about = "it has four ports (P, T, A, B), U works both ways: all edges, or the map of one"
    if not found.faults:
        every = Option(_all(found), _explained(found), (f"--ports={group.name}",), 0.5)
        return Question(about, (every, *_single(group.name, found)))
    right = corrected(group, record, found, given)
    options = [_whole(group.name, text, edges) for text, edges in right.items()]
    options += _single(group.name, next(iter(right.values()), found))
    return Question(f"{about}; not all, because {'; '.join(found.faults)}", tuple(options))


def corrected(group: Group, record: Record, found: Edges, given: Given) -> dict[str, Edges]:
    """Return the readings that nothing contradicts once they are answered, by their assumption."""
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
    right = {}
    for text, (named, scaled) in readings.items():
        answered = {role: replace(scale, stated=True) for role, scale in scaled.items()}
        whole = Given({role: one.node for role, one in named.items()}, answered, ports=True)
        edges = edges_of(group, record, whole)
        if edges is not None and not edges.faults:
            right[text] = edges
    return right


def _whole(valve: str, text: str, edges: Edges) -> Option:
    reading = edges.reading
    answers = [a for role in reading.nodes for a in _answers(valve, role, NAMES[role], reading)]
    seen = ", ".join(_seen(role, reading) for role in reading.nodes)
    return Option(
        f"{text}: {_all(edges)}",
        f"{seen}; {_explained(edges)}",
        (f"--ports={valve}", *answers),
        0.5,
    )


def _single(valve: str, edges: Edges) -> Iterator[Option]:
    """Yield the edges from P with a meter; for the other direction U is reversed."""
    for edge, port, meter in _EDGES:
        law = edges.fits.get(edge)
        if law is None:
            continue
        reading = edges.reading
        if edge is Edge.PB:
            reading = replace(reading, scales={**reading.scales, Role.U: _turned(reading)})
        roles = {Role.U: "U", Role.P1: "p1", port: "p2", meter: "Q"}
        answers = [a for role, name in roles.items() for a in _answers(valve, role, name, reading)]
        said = [f"the orifice law explains {100 * law.explained:.0f} % of the flow there"]
        said = said if law.moves else []
        said += ["but it flows against the pressures"] if law.reversed_share > AGAINST else []
        said += ["samples of the other direction are not learnt (gate.U.low = 0)"]
        text = f"edge {edge}: p1 = pP, p2 = p{edge.to}"
        yield Option(text, "; ".join(said), tuple(answers), 0.5)


def _turned(reading: Reading) -> Scale:
    measure = reading.scales[Role.U].measure
    least, most = measure.scaled or (-100.0, 100.0)
    turned = replace(measure, raw=measure.raw or (-100.0, 100.0), scaled=(0.0 - least, 0.0 - most))
    return Scale(turned, 0.0, "")


def _answers(valve: str, role: Role, name: str, reading: Reading) -> tuple[str, str]:
    unit = reading.scales[role].text or QUANTITY[role].value
    return (
        f"--signal={valve}.{name}={reading.nodes[role].node}", f"--scale={valve}.{name}={unit}",
    )  # fmt: skip


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
