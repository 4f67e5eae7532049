"""Readings of one valve's signals, each with its probability.

A reading assigns variables to roles and scales to variables. Its score is a sum of log likelihoods:
names and stated units (:mod:`roles`, :mod:`candidates`), readings of numbers (:mod:`scales`),
ranges, magnitudes, the name plate, and the orifice law (:mod:`evidence`). Competing with the
readings by labels are those in which a label is a mistake: two signals swapped, a unit that is
another one; and the hypothesis that none of them is right.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, islice, product
from math import exp, inf, log
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.plant import evidence
from valvemap.plant.candidates import Candidate
from valvemap.plant.evidence import Rating
from valvemap.plant.grouping import Group
from valvemap.plant.law import NOT_TESTED, Fit, fit
from valvemap.plant.roles import Role
from valvemap.plant.scales import Scale, mistaken, scales

Floats = NDArray[np.float64]

_UNWATCHED: Final = np.full(1, np.nan)
SWAPPED: Final = log(0.005 / 6)  # prior of two given signals swapped
MISTAKEN: Final = log(0.005 / 16)  # prior of one given unit that is another
UNKNOWN: Final = log(0.003)  # prior of numbers in no unit of the tables
NONE_RIGHT: Final = log(0.005)
MISSING: Final = -4.0  # nats: a required signal that is not there
_NO_TEMPERATURE: Final = -1.0
_UNLIKE: Final = -4.0  # nats
_UNLIKELY: Final = 25.0  # nats of prior below the best scales
_NEGLIGIBLE: Final = 14.0  # nats below the best
_MOST_ASSIGNMENTS, _MOST_SCALES = 40, 700
_WITH_MISTAKES: Final = 3  # readings by labels that are varied
_WITH_PRESSURES: Final = (Role.U, Role.P1, Role.P2, Role.Q)
_WITH_DIFFERENCE: Final = (Role.U, Role.DP, Role.Q)


@dataclass(frozen=True)
class Record:
    """Values of variables at equal steps, by node; NaN where there is none."""

    values: Mapping[str, Floats] = field(default_factory=dict)
    step_s: float = 0.1

    def of(self, candidate: Candidate) -> Floats:
        """Return the values of a variable; one NaN if it was not watched."""
        return self.values.get(candidate.node, _UNWATCHED)


@dataclass(frozen=True)
class Reading:
    """One reading: nodes and scales by role. ``mistake`` says which label it holds to be wrong.

    ``contradictions`` are what speaks against it, in nats, beside names and law.
    """

    nodes: Mapping[Role, Candidate]
    scales: Mapping[Role, Scale]
    score: float
    fit: Fit = NOT_TESTED
    mistake: str = ""
    values: Mapping[Role, Floats] = field(default_factory=dict, compare=False)
    probability: float = 0.0
    contradictions: Mapping[str, float] = field(default_factory=dict, compare=False)
    prior: float = 0.0

    @property
    def missing(self) -> tuple[Role, ...]:
        """Required roles without a node."""
        wanted = _WITH_DIFFERENCE if Role.DP in self.nodes else _WITH_PRESSURES
        return tuple(role for role in wanted if role not in self.nodes)

    @property
    def key(self) -> tuple[object, ...]:
        """Equal for readings that give the same configuration."""
        return tuple(
            (role, self.nodes[role].node, self.scales[role].text) for role in sorted(self.nodes)
        )

    @property
    def assumed(self) -> tuple[Role, ...]:
        """Roles whose unit nothing states."""
        return tuple(role for role, scale in self.scales.items() if not scale.stated)


@dataclass(frozen=True)
class Given:
    """Answers for one valve: nodes and scales that are settled."""

    nodes: Mapping[Role, str] = field(default_factory=dict)
    scales: Mapping[Role, Scale] = field(default_factory=dict)
    assume: bool = False


class _Memo:
    """What the readings of one record have in common: scaled signals, and fits of the law."""

    def __init__(self, record: Record) -> None:
        self._record = record
        self._fits: dict[object, Fit] = {}
        self._signals: dict[object, evidence.Signal] = {}

    def signal(self, node: Candidate, scale: Scale, role: Role) -> evidence.Signal:
        """Return a variable's values in the scale, as the role has them."""
        key = node.node, scale.text, role
        if (found := self._signals.get(key)) is None:
            found = evidence.Signal(scale(self._record.of(node), role))
            self._signals[key] = found
        return found

    def fit(
        self,
        nodes: Mapping[Role, Candidate],
        chosen: Mapping[Role, Scale],
        values: Mapping[Role, Floats],
    ) -> Fit:
        """Return the law's fit, for which the scales of U and Q do not matter."""
        pressures = [
            (role, nodes[role].node, chosen[role].text)
            for role in (Role.P1, Role.P2, Role.DP)
            if role in nodes
        ]
        key = nodes[Role.U].node, nodes[Role.Q].node, *pressures
        if (found := self._fits.get(key)) is None:
            drop = evidence.pressure_drop(values)
            found = fit(values[Role.U], drop, values[Role.Q], self._record.step_s)
            self._fits[key] = found
        return found


def readings(group: Group, record: Record, given: Given, rating: Rating) -> list[Reading]:
    """Return the readings of a valve's variables with their probabilities, the likeliest first.

    The probabilities do not add up to 1: the rest is the hypothesis that none is right.
    """
    memo = _Memo(record)
    found = sorted(_by_labels(group, record, given, rating, memo), key=lambda r: -r.score)
    if not found:
        return []
    varied = [
        other
        for reading in found[:_WITH_MISTAKES]
        if not reading.missing
        for other in _with_mistakes(reading, record, given, rating, memo, found[0].score)
        if other is not None
    ]
    best = max(found[0].score, *(r.score for r in varied)) if varied else found[0].score
    kept = [r for r in (*found, *varied) if r is found[0] or r.score > best - _NEGLIGIBLE]
    others: list[float] = []
    if not (given.nodes or given.scales):
        first = found[0]
        prior = _label_score(first)
        none = _logsum(prior + NONE_RIGHT, _without_weakest(first))
        none += evidence.of_no_law(first.fit)
        unknown = first.score - sum(first.contradictions.values()) + UNKNOWN
        others = [none, unknown]
    top = max(best, *others) if others else best
    total = sum(exp(score - top) for score in (*(r.score for r in kept), *others))
    merged: dict[tuple[object, ...], Reading] = {}
    for r in sorted(kept, key=lambda r: -r.score):
        p = exp(r.score - top) / total
        same = merged.get(r.key, replace(r, probability=0.0))
        merged[r.key] = replace(same, probability=same.probability + p)
    return sorted(merged.values(), key=lambda r: -r.probability)


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


def _by_labels(
    group: Group, record: Record, given: Given, rating: Rating, memo: _Memo
) -> Iterator[Reading]:
    assignments = _assignments(group, given)
    is_lacking = _lacks(assignments[0][0])  # whatever the values are
    for nodes, prior in assignments:
        if _lacks(nodes) is not is_lacking:
            continue
        options = [
            [(role, scale) for scale in _scales_of(role, node, record, given)]
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
            reading = _judged(dict(nodes), dict(chosen), prior, record, rating, memo)
            if reading is not None:
                yield reading


def _lacks(nodes: Mapping[Role, Candidate]) -> bool:
    return bool(Reading(nodes, {}, 0.0).missing)


def _scales_of(role: Role, node: Candidate, record: Record, given: Given) -> list[Scale]:
    if role in given.scales:
        return [given.scales[role]]
    values = record.of(node)
    return scales(node, role, values, assume=given.assume)


def _assignments(group: Group, given: Given) -> list[tuple[Mapping[Role, Candidate], float]]:
    """Return assignments of distinct variables to roles with their log priors, the best first."""
    wanted = _with_or_without_difference(group, given)
    options: list[list[tuple[Candidate | None, float]]] = []
    for role in wanted:
        answered = [one for one in group.all if one.node == given.nodes.get(role)]
        if answered:
            options.append([(answered[0], 0.0)])
            continue
        free = [one for one in group.all if one.node not in given.nodes.values()]
        gains: list[tuple[Candidate | None, float]] = [
            (one, one.label.gain(role)) for one in free if one.label.evidence[role] > 0.0
        ]
        none = _NO_TEMPERATURE if role is Role.T else MISSING
        gains.append((None, none))
        best = max(gain for _, gain in gains)
        options.append([pair for pair in gains if pair[1] > best - _NEGLIGIBLE])
    found: list[tuple[Mapping[Role, Candidate], float]] = []
    for pairs in islice(product(*options), 5_000):
        nodes = [one.node for one, _ in pairs if one is not None]
        if len(set(nodes)) == len(nodes):
            chosen = zip(wanted, (one for one, _ in pairs), strict=True)
            assigned = {role: one for role, one in chosen if one is not None}
            found.append((assigned, sum(gain for _, gain in pairs)))
    found.sort(key=lambda pair: -pair[1])
    return found[:_MOST_ASSIGNMENTS]


def _with_or_without_difference(group: Group, given: Given) -> tuple[Role, ...]:
    """Return the roles to fill: with Δp if a transmitter is there and two pressures are not."""
    has_difference = any(one.label.role is Role.DP for one in group.all)
    sides = [any(one.label.gain(role) > 0.0 for one in group.all) for role in (Role.P1, Role.P2)]
    asked = {Role.P1, Role.P2} & set(given.nodes)
    if Role.DP in given.nodes or (has_difference and not all(sides) and not asked):
        return (*_WITH_DIFFERENCE, Role.T)
    return (*_WITH_PRESSURES, Role.T)


def _judged(
    nodes: Mapping[Role, Candidate],
    chosen: Mapping[Role, Scale],
    prior: float,
    record: Record,
    rating: Rating,
    memo: _Memo,
    mistake: str = "",
    labelled: Mapping[Role, Candidate] | None = None,
    best: float = -inf,
) -> Reading | None:
    """Score a reading; ``labelled`` are the variables whose ranges belong to the roles.

    None if no law
    could make the reading more than negligible beside one with the score ``best``.
    """
    ranges = labelled or nodes
    score = prior + sum(scale.prior for scale in chosen.values()) + _of_pair(chosen)
    raw = {role: record.of(node) for role, node in nodes.items()}
    signals = {role: memo.signal(node, chosen[role], role) for role, node in nodes.items()}
    values = {role: signal.values for role, signal in signals.items()}
    if _lacks(nodes):
        return Reading(nodes, chosen, score, NOT_TESTED, mistake, values)
    against = {
        f"{role} leaves its range": _of_range(node, role, chosen[role], raw[role])
        for role, node in ranges.items()
    }
    against |= evidence.of_magnitudes(signals, rating)
    against["Q flows at U = 0"] = evidence.of_shut_valve(signals)
    score += sum(against.values())
    if score + evidence.most_of_law(len(values[Role.Q])) < best - _NEGLIGIBLE:
        return None
    tested = memo.fit(nodes, chosen, values)
    unmoved = against["Q does not move with U"] = evidence.of_response(values, tested)
    score += evidence.of_law(tested) + unmoved
    return Reading(
        nodes, chosen, score, tested, mistake, values, contradictions=against, prior=prior
    )


def _of_pair(chosen: Mapping[Role, Scale]) -> float:
    """Judge scales that nothing states by their likeness: one card, one kind of sensor."""
    guessed = [scale.measure for scale in chosen.values() if not scale.stated]
    spans = {abs(measure.raw[1]) for measure in guessed if measure.raw is not None}
    total = _UNLIKE * max(len(spans) - 1, 0)
    pair = [chosen[role] for role in (Role.P1, Role.P2) if role in chosen]
    if len(pair) > 1 and not all(scale.stated for scale in pair):
        one, other = (scale.measure for scale in pair)
        total += 0.0 if (one.unit, one.scaled) == (other.unit, other.scaled) else _UNLIKE
    return total


def _of_range(node: Candidate, role: Role, scale: Scale, raw: Floats) -> float:
    """Judge raw values by a variable's range: in the stated unit, or as the range of the counts."""
    if node.bounds is None:
        return 0.0
    measure = scale.measure
    if measure.raw is not None and measure.scaled == node.bounds:
        return evidence.of_range(raw, measure.raw, role)
    stated = next((u for u in node.label.units if u == measure.unit), None)
    if measure.raw is None and measure.unit is not None and stated is None and node.label.units:
        own = node.label.units[0]
        if own.quantity is measure.unit.quantity:  # the range is in the stated unit
            factor = float(measure.unit.factor / own.factor)
            return evidence.of_range(raw * factor, node.bounds, role)
    return evidence.of_range(raw, node.bounds, role)


def _with_mistakes(
    reading: Reading,
    record: Record,
    given: Given,
    rating: Rating,
    memo: _Memo,
    best: float,
) -> Iterator[Reading | None]:
    """Yield the variations of a reading in which labels are mistaken; None for negligible ones."""
    prior = reading.prior
    learnt = [r for r in reading.nodes if r is not Role.T and r not in given.nodes]
    for one, other in combinations(learnt, 2):
        nodes = dict(reading.nodes)
        nodes[one], nodes[other] = nodes[other], nodes[one]
        what = f"{one} and {other} are swapped"
        yield _judged(
            nodes, reading.scales, prior + SWAPPED, record, rating, memo, what, reading.nodes, best
        )
    for roles in _mistakable(reading, given):
        first = roles[0]
        for scale in mistaken(reading.scales[first], first):
            chosen = {**reading.scales, **dict.fromkeys(roles, scale)}
            what = f"{' and '.join(roles)} {'is' if len(roles) == 1 else 'are'} {scale.reason}"
            yield _judged(
                *(dict(reading.nodes), chosen, prior + MISTAKEN, record, rating, memo, what),
                best=best,
            )


def _mistakable(reading: Reading, given: Given) -> Iterator[Sequence[Role]]:
    stated = [
        role
        for role, scale in reading.scales.items()
        if scale.stated and role not in given.scales and role not in {Role.U, Role.T}
    ]
    for role in stated:
        yield [role]
    if {Role.P1, Role.P2} <= set(stated):
        own = reading.scales
        if own[Role.P1].measure.unit == own[Role.P2].measure.unit:
            yield [Role.P1, Role.P2]
