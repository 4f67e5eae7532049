"""Decides on a valve: accepts the likeliest reading, or asks with the readings that remain."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from valvemap.plant import port_questions, ports, reading_questions
from valvemap.plant.copies import without_copies
from valvemap.plant.evidence import Rating
from valvemap.plant.grouping import Group
from valvemap.plant.law import Fit
from valvemap.plant.other_meters import other_meter
from valvemap.plant.possible import explained_assignments
from valvemap.plant.questions import Question
from valvemap.plant.reading import Given, Reading, Record
from valvemap.plant.readings import LIKELY, readings, without_ambiguous_oil
from valvemap.plant.references import question_of_reference
from valvemap.plant.roles import Role
from valvemap.vocabulary.edges import Edge


@dataclass(frozen=True)
class Verdict:
    """The result for one valve. ``reading`` is to be configured only if ``question`` is None.

    ``others`` are signals recognised as none of the map's, by node; ``least_U`` is set where only
    one direction is learnt; ``edges`` are the law's fits where the reading is one of all edges.
    ``rating`` is the given part of the name plate.
    """

    valve: str
    reading: Reading | None
    question: Question | None
    others: Mapping[str, Role]
    least_U: float | None = None
    edges: Mapping[Edge, Fit] = field(default_factory=dict)
    rating: Rating = field(default_factory=Rating)

    @property
    def has_ports(self) -> bool:
        """Whether all edges of a valve with ports are learnt."""
        return bool(self.edges)

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
    if group.is_possible and not given.nodes:
        return replace(_of_possible(group, record, given, rating), rating=rating)
    group, copies = without_copies(group, record, given)
    found = _judged(group, record, given, rating)
    others = {**found.others, **{one.node: one.label.role for one in copies}}
    taken = () if found.reading is None else found.reading.nodes.values()
    for one in taken:  # by an answer, whatever its name is
        others.pop(one.node, None)
    return replace(found, rating=rating, others=others)


def _of_possible(group: Group, record: Record, given: Given, rating: Rating) -> Verdict:
    """Return the question whether variables are a valve's; one without it if they are none."""
    found = [
        readings(group, record, replace(given, nodes={r: n.node for r, n in roles.items()}), rating)
        for roles, _ in explained_assignments(group.all, record, group.used)
    ]
    whole = [[one for one in own if not (one.missing or one.mistake)] for own in found]
    question = reading_questions.question_of_possible(group.name, whole) if any(whole) else None
    return Verdict(group.name, None, question, {})


def _judged(group: Group, record: Record, given: Given, rating: Rating) -> Verdict:
    others = {one.node: one.label.role for one in group.all if not one.label.is_relevant}
    is_answered = {Role.P1, Role.P2} <= set(given.nodes)
    if given.ports or (ports.is_directional(group) and not is_answered):
        of_ports = _of_ports(group, record, given)
        if of_ports is not None:
            return replace(of_ports, others=others)
    found = readings(group, ports.one_direction(group, record, given), given, rating)
    if not found:
        return Verdict(group.name, None, Question("no reading of its signals fits"), others)
    found = without_ambiguous_oil(found, given)
    best = found[0]
    least_U = 0.0 if ports.is_directional(group) else None
    if group.one_meter and Role.Q not in given.nodes and Role.Q in best.nodes:
        named = next((r for r in found if not (r.mistake or r.missing or r.beside)), best)
        return Verdict(
            group.name,
            named,
            reading_questions.question_of_one_meter(group, named),
            others,
            least_U,
        )
    if best.missing:
        return Verdict(
            group.name,
            best,
            reading_questions.question_of_missing(group, best, record, rating),
            others,
        )
    twin = None if Role.Q in given.nodes else other_meter(best, group, record)
    is_clear = best.probability >= LIKELY and not best.mistake and not best.beside
    if is_clear and twin is None:
        foreign = reading_questions.in_foreign_units(best, given)
        asked: Question | None
        if foreign:
            asked = reading_questions.question_of_units(group.name, best, foreign)
        else:
            asked = question_of_reference(group, best, record, given, rating)
        return Verdict(group.name, best, asked, others, least_U)
    if twin is None:
        question = reading_questions.question_of_readings(group.name, found)
    else:
        kept = {role: node.node for role, node in best.nodes.items()}
        answered = replace(given, nodes={**kept, Role.Q: twin.node})
        question = reading_questions.question_of_meters(
            group.name, best, readings(group, record, answered, rating)[0]
        )
    return Verdict(group.name, best, question, others, least_U)


def _of_ports(group: Group, record: Record, given: Given) -> Verdict | None:
    """Return the verdict on a valve with four ports; None if signals of it are missing."""
    found = ports.edges_of(group, record, given)
    if found is None:
        missing = port_questions.question_of_missing(group, given)
        return Verdict(group.name, None, missing, {}) if given.ports else None
    if given.ports:
        fault = (
            port_questions.question_of_faults(group, record, found, given) if found.faults else None
        )
        return Verdict(group.name, found.reading, fault, {}, edges=found.fits)
    question = port_questions.question_of_ports(group, record, found, given)
    return Verdict(group.name, found.reading, question, {}, 0.0)
