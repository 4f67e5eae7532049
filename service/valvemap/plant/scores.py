"""The score of a reading: log likelihoods of its labels, units, ranges, magnitudes, and the law."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from math import inf, lgamma, log
from typing import Final

import numpy as np

from valvemap.foreign_text import printable
from valvemap.plant import evidence
from valvemap.plant.assignments import NEGLIGIBLE, lacks
from valvemap.plant.candidates import Candidate
from valvemap.plant.concepts import Concept
from valvemap.plant.evidence import Rating
from valvemap.plant.grouping import Group, Unmetered
from valvemap.plant.law import Fit, fit
from valvemap.plant.reading import Floats, Reading, Record
from valvemap.plant.roles import Role
from valvemap.plant.scales import COUNTS, Scale, scales
from valvemap.plant.unit_systems import of_guesses

BACKWARDS: Final = "p2 is above p1"  # in every unit
_OF_OTHER_FLOWS: Final = ("Q does not move with U", "Q flows at U = 0")
_UNLIKE: Final = -4.0  # nats; two signals from different cards, two gauges of different spans
_OF_CARDS: Final = frozenset((1.0, *(high for _, high in COUNTS)))
_ONE_METER: Final = log(0.1)  # prior that a meter measures a valve that has none, too


class Scores:
    """Scores the readings of one valve's variables; keeps what several of them share."""

    def __init__(self, group: Group, record: Record, rating: Rating) -> None:
        self._group, self._record, self._rating = group, record, rating
        self._fits: dict[object, Fit] = {}
        self._signals: dict[object, evidence.Signal] = {}
        self._dismissed: dict[object, dict[str, float]] = {}

    def reading(
        self,
        nodes: Mapping[Role, Candidate],
        chosen: Mapping[Role, Scale],
        prior: float,
        mistake: str = "",
        labelled: Mapping[Role, Candidate] | None = None,
        best: float = -inf,
    ) -> Reading | None:
        """Return a scored reading; ``labelled`` are the variables whose ranges belong to the roles.

        None if no law could make it more than negligible beside one with the score ``best``.
        """
        score = prior + sum(scale.prior for scale in chosen.values()) + _of_units(chosen)
        raw = {role: self._record.of(node) for role, node in nodes.items()}
        signals = {role: self._signal(node, chosen[role], role) for role, node in nodes.items()}
        values = {role: signal.values for role, signal in signals.items()}
        if lacks(nodes):
            return Reading(nodes, chosen, score, mistake=mistake, values=values)
        against = {
            f"{role} leaves its range": _of_range(node, role, chosen[role], raw[role])
            for role, node in (labelled or nodes).items()
        }
        against |= evidence.of_magnitudes(signals, self._rating) | self._of_dismissed(nodes)
        against["Q flows at U = 0"] = evidence.of_shut_valve(signals)
        against[BACKWARDS] = evidence.of_direction(values)
        score += sum(against.values())
        if score + evidence.most_of_law(len(values[Role.Q])) < best - NEGLIGIBLE:
            return None
        tested = self._fit(nodes, chosen, values)
        late = {"Q does not move with U": evidence.of_response(values, tested)}
        for role in (Role.P1, Role.P2, Role.DP) if tested.moves else ():
            if role in nodes and Concept.TANK not in nodes[role].label.concepts:
                late[f"{role} is exactly 0 all the time"] = evidence.of_dead_sensor(raw[role])
        against |= late
        score += evidence.of_law(tested) + sum(late.values())
        return Reading(
            nodes, chosen, score, tested, mistake, values, contradictions=against, prior=prior
        )

    def with_others(self, reading: Reading) -> Reading | None:
        """Return the same reading with a meter that measures the valves without one, too."""
        if not self._group.unmetered:
            return None
        values, alone = reading.values, reading.fit
        drives = (self._drive(one) for one in self._group.unmetered)
        beside = [(U, dp) for U, dp in drives if len(U) == len(dp) == len(values[Role.Q])]
        drop = evidence.pressure_drop(values)
        joint = fit(values[Role.U], drop, values[Role.Q], self._record.step_s, beside)
        relieved = {name: nats for name, nats in reading.contradictions.items()
                    if name in _OF_OTHER_FLOWS}  # fmt: skip
        score = reading.score - sum(relieved.values())
        score += evidence.of_others(alone, joint) + _ONE_METER
        return Reading(
            reading.nodes, reading.scales, score, joint, values=values, prior=reading.prior,
            contradictions={**reading.contradictions, **dict.fromkeys(relieved, 0.0)},
            beside=tuple(one.name for one in self._group.unmetered),
        )  # fmt: skip

    def _drive(self, other: Unmetered) -> tuple[Floats, Floats]:
        """Return U and Δp of another valve, in units that may be wrong by a factor."""
        scaled = {
            role: scales(node, role, values)[0](values, role)
            for role, node in other.nodes.items()
            if len(values := self._record.of(node)) > 1
        }
        if not {Role.U, *other.pressures} <= set(scaled):
            return np.empty(0), np.empty(0)
        return scaled[Role.U], evidence.pressure_drop(scaled)

    def _signal(self, node: Candidate, scale: Scale, role: Role) -> evidence.Signal:
        key = node.node, scale.text, role
        if (found := self._signals.get(key)) is None:
            found = evidence.Signal(scale(self._record.of(node), role))
            self._signals[key] = found
        return found

    def _of_dismissed(self, nodes: Mapping[Role, Candidate]) -> dict[str, float]:
        """Judge the ranges of variables that are labelled better than those taken.

        That a variable leaves its range is as unlikely if another one takes its place.
        """
        key = tuple((role, one.node) for role, one in nodes.items())
        if (found := self._dismissed.get(key)) is None:
            found = self._dismissed[key] = dict(self._judged_ranges(nodes))
        return found

    def _judged_ranges(self, nodes: Mapping[Role, Candidate]) -> Iterator[tuple[str, float]]:
        taken = {one.node for one in nodes.values()}
        for one in self._group.all:
            role = one.label.role
            if one.node in taken or role not in nodes:
                continue
            if one.label.gain(role) >= nodes[role].label.gain(role):
                nats = evidence.of_range(self._record.of(one), one.bounds, role)
                yield f"{printable(one.path[-1])}, not taken for {role}, leaves its range", nats

    def _fit(
        self,
        nodes: Mapping[Role, Candidate],
        chosen: Mapping[Role, Scale],
        values: Mapping[Role, Floats],
    ) -> Fit:
        """Return the law's fit, for which but the direction of U the scales of U and Q are one."""
        pressures = [
            (role, nodes[role].node, chosen[role].text)
            for role in (Role.P1, Role.P2, Role.DP)
            if role in nodes
        ]
        ends = chosen[Role.U].measure.scaled or (0.0, 100.0)
        key = nodes[Role.U].node, ends[0] < ends[1], nodes[Role.Q].node, *pressures
        if (found := self._fits.get(key)) is None:
            drop = evidence.pressure_drop(values)
            U, Q, step = values[Role.U], values[Role.Q], self._record.step_s
            found = fit(U, drop, Q, step, p1=values.get(Role.P1))
            self._fits[key] = found
        return found


def _of_units(chosen: Mapping[Role, Scale]) -> float:
    """Judge scales that nothing states: one system of units, one card, one kind of sensor."""
    units = {r: s.measure.unit for r, s in chosen.items() if s.measure.unit is not None}
    of_pressures = [chosen[role] for role in (Role.P1, Role.P2) if role in chosen]
    ends = {s.measure.scaled for s in of_pressures}
    unlike = len(ends) > 1 and not all(s.stated for s in of_pressures)
    return (
        _UNLIKE * unlike
        + _of_cards(_spans(chosen))
        + of_guesses(
            {role: unit for role, unit in units.items() if chosen[role].stated},
            {role: unit for role, unit in units.items() if chosen[role].guessed},
        )
    )


def _spans(chosen: Mapping[Role, Scale]) -> list[float]:
    """Return the ends of the raw spans that nothing states; stated ones too if both are counts."""
    cards = [(scale.card, scale.stated) for scale in chosen.values()]
    unstated = [card for card, stated in cards if card is not None and not stated]
    if not _OF_CARDS.intersection(unstated):
        return unstated
    return unstated + [card for card, stated in cards if stated and card in _OF_CARDS]


def _of_cards(spans: Sequence[float]) -> float:
    """Judge that signals come from different cards, against one for all (Ewens 1972).

    The more signals share a span, the likelier the next one does, too.

    >>> round(_of_cards([27_648.0, 32_767.0]), 1), round(_of_cards([27_648.0] * 4 + [4_095.0]), 1)
    (-4.0, -5.4)
    """
    if not spans:
        return 0.0
    of_each = Counter(spans).values()
    return _UNLIKE * (len(of_each) - 1) + sum(map(lgamma, of_each)) - lgamma(len(spans))


def _of_range(node: Candidate, role: Role, scale: Scale, raw: Floats) -> float:
    """Judge raw values by a variable's range: in the stated unit, or as the range of the counts."""
    if node.bounds is None:
        return 0.0
    measure = scale.measure
    if node.companion is not None and measure.raw is not None and measure.scaled is not None:
        (low, high), (least, most) = measure.raw, measure.scaled
        products = least + (raw - low) * ((most - least) / (high - low))
        return max(evidence.of_range(own, node.bounds, role) for own in (raw, products))
    if measure.raw is not None and measure.scaled == node.bounds:
        return evidence.of_range(raw, measure.raw, role)
    stated = next((u for u in node.label.units if u == measure.unit), None)
    if measure.raw is None and measure.unit is not None and stated is None and node.label.units:
        own = node.label.units[0]
        if own.quantity is measure.unit.quantity:  # the range is in the stated unit
            factor = float(measure.unit.factor / own.factor)
            return evidence.of_range(raw * factor, node.bounds, role)
    return evidence.of_range(raw, node.bounds, role)
