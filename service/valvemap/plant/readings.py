"""Readings of one valve's signals, each with its probability.

A reading assigns variables to roles and scales to variables. Its score is a sum of log likelihoods:
names and stated units (:mod:`roles`, :mod:`candidates`), readings of numbers (:mod:`scales`),
ranges, magnitudes, the name plate, and the orifice law (:mod:`evidence`). Competing with the
readings by labels are those in which a label is a mistake: two signals swapped, one that is another
valve's, a command that shuts at 100 %, a unit that is another one; and the hypothesis that none of
them is right.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, islice, product
from math import exp, log
from typing import Final

from valvemap.plant import evidence
from valvemap.plant.assignments import MISSING, NEGLIGIBLE, assignments, lacks, scales_of
from valvemap.plant.candidates import Candidate
from valvemap.plant.evidence import Rating
from valvemap.plant.grouping import Group
from valvemap.plant.mistaken_scales import mistaken, reversed_command
from valvemap.plant.priors import MISTAKE
from valvemap.plant.reading import Given, Reading, Record
from valvemap.plant.roles import Role
from valvemap.plant.scales import Scale
from valvemap.plant.scores import BACKWARDS, Scores
from valvemap.plant.unit_systems import of_mistaken_flow

LIKELY: Final = 0.95  # probability of a reading that is taken without a question
_AS_LIKELY: Final = 0.1  # probability of a reading with another temperature
SWAPPED: Final = log(MISTAKE / 6)  # prior of two given signals swapped
REVERSED: Final = log(MISTAKE)  # prior of a valve that is shut at the upper end of U
EXCHANGED: Final = log(MISTAKE / 12)  # prior of a signal exchanged with that of another valve
MISTAKEN: Final = log(MISTAKE / 16)  # prior of one given unit that is another
UNKNOWN: Final = log(0.003)  # prior of numbers in no unit of the tables
NONE_RIGHT: Final = log(MISTAKE)
_UNLIKELY: Final = 25.0  # nats of prior below the best scales
_MOST_SCALES: Final = 700
_WITH_MISTAKES: Final = 3  # readings by labels that are varied


def readings(group: Group, record: Record, given: Given, rating: Rating) -> list[Reading]:
    """Return the readings of a valve's variables with their probabilities, the likeliest first.

    The probabilities do not add up to 1: the rest is the hypothesis that none is right.
    """
    judge = Scores(group, record, rating)
    found = sorted(_by_labels(group, record, given, judge), key=lambda r: -r.score)
    if not found:
        return []
    varied = [
        other
        for reading in found[:_WITH_MISTAKES]
        if not reading.missing
        for other in _variations(reading, group, record, given, judge, found[0].score)
        if other is not None
    ]
    best = max(found[0].score, *(r.score for r in varied)) if varied else found[0].score
    kept = [r for r in (*found, *varied) if r is found[0] or r.score > best - NEGLIGIBLE]
    others: list[float] = []
    if not (given.nodes or given.scales):
        first = found[0]
        prior = _label_score(first)
        none = _logsum(prior + NONE_RIGHT, _without_weakest(first))
        none += evidence.of_no_law(first.fit)
        of_units = sum(n for name, n in first.contradictions.items() if name != BACKWARDS)
        unknown = first.score - of_units + UNKNOWN
        others = [none, unknown]
    top = max(best, *others) if others else best
    total = sum(exp(score - top) for score in (*(r.score for r in kept), *others))
    merged: dict[tuple[object, ...], Reading] = {}
    for r in sorted(kept, key=lambda r: -r.score):
        p = exp(r.score - top) / total
        same = merged.get(r.key, replace(r, probability=0.0))
        merged[r.key] = replace(same, probability=same.probability + p)
    return sorted(merged.values(), key=lambda r: -r.probability)


def without_ambiguous_oil(found: list[Reading], given: Given) -> list[Reading]:
    """Return the readings, those that differ in the temperature alone as one without it.

    A valve needs no temperature: of several that are as likely, none is taken.
    """
    oils = {r.nodes[Role.T].node for r in found if Role.T in r.nodes and r.probability > _AS_LIKELY}
    if Role.T in given.nodes or len(oils) < 2:
        return found
    merged: dict[tuple[object, ...], Reading] = {}
    for one in found:
        bare = _without_oil(one)
        same = merged.get(bare.key, replace(bare, probability=0.0))
        merged[bare.key] = replace(same, probability=same.probability + one.probability)
    together = max(merged.values(), key=lambda one: one.probability)
    is_ambiguous = found[0].probability < LIKELY < together.probability
    return sorted(merged.values(), key=lambda r: -r.probability) if is_ambiguous else found


def _without_oil(reading: Reading) -> Reading:
    kept = [role for role in reading.nodes if role is not Role.T]
    return replace(
        reading,
        nodes={role: reading.nodes[role] for role in kept},
        scales={role: reading.scales[role] for role in kept},
        values={role: reading.values[role] for role in kept},
    )


def _without_weakest(reading: Reading) -> float:
    """Return the log prior that the weakest of the signals is another one, its own being absent."""
    required = [role for role in reading.nodes if role is not Role.T]
    gains = [reading.nodes[role].label.gain(role) for role in required]
    return sum(gains) - min(gains, default=0.0) + MISSING


def _logsum(one: float, other: float) -> float:
    return max(one, other) + log(1.0 + exp(-abs(one - other)))


def _label_score(reading: Reading) -> float:
    return sum(reading.nodes[role].label.gain(role) for role in reading.nodes) + MISSING * len(
        reading.missing
    )


def _by_labels(group: Group, record: Record, given: Given, judge: Scores) -> Iterator[Reading]:
    found = assignments(group, given)
    if not found:
        return  # two answers name one node
    is_lacking = lacks(found[0][0])  # whatever the values are
    for nodes, prior in found:
        if lacks(nodes) is not is_lacking:
            continue
        options = [
            [(role, scale) for scale in scales_of(role, node, record, given)]
            for role, node in nodes.items()
        ]
        if not all(options):
            continue  # a signal that no unit makes plausible
        best = sum(max(scale.prior for _, scale in own) for own in options)
        likely = (
            chosen
            for chosen in product(*options)
            if sum(scale.prior for _, scale in chosen) > best - _UNLIKELY
        )
        for chosen in islice(likely, _MOST_SCALES):
            reading = judge.reading(dict(nodes), dict(chosen), prior)
            if reading is not None:
                yield reading


def _variations(
    reading: Reading, group: Group, record: Record, given: Given, judge: Scores, best: float
) -> Iterator[Reading | None]:
    """Yield those in which labels are mistaken, or the meter is not its own; None: negligible."""
    if Role.Q not in given.nodes:
        yield judge.with_others(reading)
    for one in (*_swapped(reading, given), *_exchanged(reading, group, record, given)):
        nodes, chosen, prior, what, labelled = one
        yield judge.reading(nodes, chosen, reading.prior + prior, what, labelled, best)
    for chosen, prior, what in (*_reversed(reading, given), *_in_other_units(reading, given)):
        yield judge.reading(reading.nodes, chosen, reading.prior + prior, what, best=best)


_Mistake = tuple[
    Mapping[Role, Candidate], Mapping[Role, Scale], float, str, Mapping[Role, Candidate]
]
"""Nodes, scales, prior, words, and the nodes whose ranges belong to the roles."""


def _learnt(reading: Reading, given: Given) -> list[Role]:
    return [role for role in reading.nodes if role is not Role.T and role not in given.nodes]


def _swapped(reading: Reading, given: Given) -> Iterator[_Mistake]:
    for one, other in combinations(_learnt(reading, given), 2):
        nodes = dict(reading.nodes)
        nodes[one], nodes[other] = nodes[other], nodes[one]
        yield nodes, reading.scales, SWAPPED, f"{one} and {other} are swapped", reading.nodes


def _exchanged(reading: Reading, group: Group, record: Record, given: Given) -> Iterator[_Mistake]:
    """Yield the readings in which a signal is that of another valve."""
    for valve, its in group.neighbours:
        for role in _learnt(reading, given):
            if role not in its or its[role].node == reading.nodes[role].node:
                continue
            nodes = {**reading.nodes, role: its[role]}
            own = scales_of(role, its[role], record, given)
            if own and len(record.of(its[role])) == len(record.of(reading.nodes[role])):
                chosen = {**reading.scales, role: own[0]}
                yield nodes, chosen, EXCHANGED, f"{role} is labelled as that of {valve}", nodes


def _reversed(reading: Reading, given: Given) -> Iterator[tuple[Mapping[Role, Scale], float, str]]:
    if Role.U not in given.scales:
        scale = reversed_command(reading.scales[Role.U], reading.values[Role.U])
        yield {**reading.scales, Role.U: scale}, REVERSED, f"the valve is {scale.reason}"


def _in_other_units(
    reading: Reading, given: Given
) -> Iterator[tuple[Mapping[Role, Scale], float, str]]:
    for roles in _mistakable(reading, given):
        first = roles[0]
        for scale in mistaken(reading.scales[first], first):
            what = f"{' and '.join(roles)} {'is' if len(roles) == 1 else 'are'} {scale.reason}"
            prior = _of_flow_unit(reading, scale) if first is Role.Q else MISTAKEN
            yield {**reading.scales, **dict.fromkeys(roles, scale)}, prior, what


def _of_flow_unit(reading: Reading, scale: Scale) -> float:
    """Return the prior of another unit of Q, which no law contradicts: by systems and sizes."""
    own, other = reading.scales[Role.Q].measure.unit, scale.measure.unit
    if own is None or other is None or not reading.fit.moves:  # noise has no size
        return MISTAKEN
    stated = {
        role: one.measure.unit
        for role, one in reading.scales.items()
        if one.stated and one.measure.unit is not None
    }
    label = reading.nodes[Role.Q].label
    odds = of_mistaken_flow(stated, other, label.statements)
    return odds + evidence.of_size(reading.values, float(other.factor / own.factor))


def _mistakable(reading: Reading, given: Given) -> Iterator[Sequence[Role]]:
    stated = [
        role
        for role, scale in reading.scales.items()
        if scale.stated and role not in given.scales and role is not Role.T
    ]
    for role in stated:
        yield [role]
    if {Role.P1, Role.P2} <= set(stated):
        own = reading.scales
        if own[Role.P1].measure.unit == own[Role.P2].measure.unit:
            yield [Role.P1, Role.P2]
