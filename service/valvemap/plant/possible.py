"""Variables that may be a valve's though their names do not say so: by units, values and the law.

They are never configured without an answer: each such place is a question, with the assignments
that the orifice law explains.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import Final

import numpy as np

from valvemap.pipeline.units import Quantity
from valvemap.plant.candidates import Candidate
from valvemap.plant.concepts import QUANTITIES, SIDES, Concept
from valvemap.plant.grouping import Group, nearness
from valvemap.plant.law import LEAST_ROWS, Floats, fit, moves, quantiles
from valvemap.plant.place_keys import folder_of
from valvemap.plant.place_names import short_names
from valvemap.plant.reading import Record
from valvemap.plant.roles import LEARNT, Role

FOLLOWS: Final = 0.9  # of Q, by the law: variables without names are a valve's
MOST_PLACES: Final = 20  # that are watched
_ENOUGH: Final = 0.8  # of Q, where labels tell a kind for each signal
_MOST_UNNAMED: Final = 12  # variables of a place that may be any signal
_MOST_SHARED: Final = 4  # pressures of no valve, nearest to the place
_MOST_TRIED: Final = 6_000  # assignments of a place
_MOST_TESTED: Final = 8  # of them, with lag and play
_MOST_OPTIONS: Final = 3
_ALL_TOLD: Final = 4  # signals; then a valve at rest is one, too
_TELLS_DP: Final = 0.5  # of the residual without Δp, where Δp is one
_KNOTS: Final = (0.0, 0.3, 0.6)  # shares of the samples below each
_ALIKE: Final = 0.01  # of its spread: residual of a variable's copy in other numbers
_LIKELY_OTHER: Final = 6.0  # nats by which a variable is rather another signal
_OF_ONE_PLACE: Final = SIDES | {Concept.PRESSURE}  # in words: no pressure drop
_PRESSURES: Final = (Role.P1, Role.P2, Role.PA, Role.PB)


@dataclass(frozen=True)
class Slots:
    """The variables of a place that may be each signal, and how many signals labels tell."""

    U: tuple[Candidate, ...]
    pressures: tuple[Candidate, ...]
    dp: tuple[Candidate, ...]
    Q: tuple[Candidate, ...]
    told: int

    @property
    def are_filled(self) -> bool:
        """Whether there is a variable for each signal."""
        nodes = {one.node for own in (self.U, self.pressures, self.dp, self.Q) for one in own}
        drops = len(self.pressures) > 1 or bool(self.dp)
        return bool(self.U and self.Q) and drops and len(nodes) > (2 if self.dp else 3)


def possible_valves(numbers: Iterable[Candidate], groups: Sequence[Group]) -> list[Group]:
    """Return the places whose variables, of no valve that was found, may be another one's."""
    every = list(numbers)
    taken = {one.node for own in groups for one in own.own}
    shared = {one.node for own in groups for one in own.shared}
    places: dict[tuple[str, ...], list[Candidate]] = {}
    for one in every:
        if one.node not in taken and not one.text and may_be_a_signal(one):
            places.setdefault(folder_of(one), []).append(one)
    pool = [one for own in places.values() if _is_of_a_header(own) for one in own]
    chosen = {}
    for place, own in places.items():
        mine = [one for one in own if one.node not in shared]
        near = [one for one in pool if one not in mine and _is_pressure(one)]
        near.sort(key=lambda one, first=own[0]: -nearness(first, one))  # type: ignore[misc]
        more = near[:_MOST_SHARED] if sum(map(_is_pressure, mine)) < 2 else []
        if any(not _is_pressure(one) for one in mine) and slots((*mine, *more)).are_filled:
            chosen[place] = mine, more
    names = short_names([*chosen]) if chosen else {}
    known = {one.name for one in groups}
    return [
        Group(_new_name(names[place], known), tuple(own), tuple(more), is_possible=True)
        for place, (own, more) in list(chosen.items())[:MOST_PLACES]
    ]


def _is_of_a_header(own: Sequence[Candidate]) -> bool:
    """Whether a folder holds pressures alone, or what says nothing: another device's are its own.

    A pump with a flow and a load in % has a pressure of its own.
    """
    return all(_is_pressure(one) or is_unnamed(one) for one in own)


def _new_name(name: str, known: Iterable[str]) -> str:
    """Return a name that no valve has; those known compare without case."""
    there = {one.casefold() for one in known}
    return next(
        n for n in (name, *(f"{name}_{k}" for k in range(2, 999))) if n.casefold() not in there
    )


def may_be_a_signal(one: Candidate) -> bool:
    """Whether neither name nor unit says that a variable is something else."""
    label = one.label
    says_nothing = is_unnamed(one)
    return (
        says_nothing
        or any(_may_be(one, role) for role in LEARNT if role is not Role.T)
        or (label.role in LEARNT and label.evidence[label.role] > 0.0 and label.role is not Role.T)
    )


def is_unnamed(one: Candidate) -> bool:
    """Whether neither name nor unit identifies a variable."""
    label = one.label
    named = QUANTITIES.intersection(label.concepts)
    others = label.role not in LEARNT and label.evidence[label.role] > 0.0
    return not (named or label.units or one.symbol or others)


def _may_be(one: Candidate, role: Role) -> bool:
    return one.label.evidence[role] > 0.0 and one.label.gain(role) > -_LIKELY_OTHER


def _is_pressure(one: Candidate) -> bool:
    units = {unit.quantity for unit in one.label.units}
    return Quantity.PRESSURE in units or any(_may_be(one, role) for role in _PRESSURES)


def slots(variables: Sequence[Candidate]) -> Slots:
    """Return which variables may be which signal: by unit, by name, and those that say nothing."""
    unnamed = [one for one in variables if is_unnamed(one)]
    unnamed = unnamed if len(unnamed) <= _MOST_UNNAMED else []
    said = {one.node: {unit.quantity for unit in one.label.units} for one in variables}
    flows = [
        one
        for one in variables
        if Quantity.FLOW in said[one.node] or _may_be(one, Role.Q) or _may_be(one, Role.QB)
    ]
    differences = [one for one in variables if one.label.role is Role.DP]
    pressures = [one for one in variables if _is_pressure(one) and one not in differences]
    alone = pressures if len(pressures) == 1 and not differences else []
    alone = [one for one in alone if not _OF_ONE_PLACE.intersection(one.label.concepts)]
    commands = [
        one
        for one in variables
        if said[one.node] & {Quantity.OPENING, Quantity.ELECTRICAL} or _may_be(one, Role.U)
    ]
    drops = 2 if differences else min(len(pressures), 2)
    told = bool(flows) + drops + bool(commands)
    return Slots(
        tuple(dict.fromkeys((*commands, *unnamed))),
        tuple(pressures if len(pressures) > 1 else (*pressures, *unnamed)),
        tuple(differences or alone),
        tuple(flows or unnamed),
        told,
    )


Assigned = Mapping[Role, Candidate]


def explained_assignments(
    variables: Sequence[Candidate], record: Record, used: Sequence[Candidate]
) -> list[tuple[Assigned, float]]:
    """Return assignments with the share of Q that the law explains, the best first.

    NaN where nothing moves, and labels tell enough. ``used`` are signals of other valves: an
    assignment whose U and Q are copies of theirs is left out.
    """
    there = slots(variables)
    tried = [*_assignments(there, record)]
    moving = [(roles, values) for roles, values in tried if moves(_good(values[Role.Q]))]
    if not moving:
        enough = there.told >= _ALL_TOLD and tried
        return [(tried[0][0], float("nan"))] if enough else []
    ranked = sorted(moving, key=lambda one: _left_at_once(one[1]))[:_MOST_TESTED]
    least = _ENOUGH if there.told >= _ALL_TOLD else FOLLOWS
    found = []
    for roles, values in ranked:
        law = fit(values[Role.U], _drop(values), values[Role.Q], record.step_s)
        tells = there.told >= _ALL_TOLD or _tells_of_dp(values)
        if law.moves and law.explained >= least and tells and not _are_copies(roles, record, used):
            found.append((roles, law.explained))
    found.sort(key=lambda one: -one[1])
    return found[:_MOST_OPTIONS]


def _good(values: Floats) -> Floats:
    return values[np.isfinite(values)]


def _drop(values: Mapping[Role, Floats]) -> Floats:
    return values[Role.DP] if Role.DP in values else values[Role.P1] - values[Role.P2]


def _assignments(there: Slots, record: Record) -> Iterator[tuple[Assigned, dict[Role, Floats]]]:
    """Yield assignments of distinct variables of which there are values, p1 the higher pressure."""
    drops: list[Assigned] = [{Role.DP: one} for one in there.dp]
    for one, other in combinations(there.pressures, 2):
        higher = _median(record.of(one)) >= _median(record.of(other))
        high, low = (one, other) if higher else (other, one)
        drops.append({Role.P1: high, Role.P2: low})
    tried = 0
    for Q, drop, U in product(there.Q, drops, there.U):
        nodes = {Q.node, U.node, *(one.node for one in drop.values())}
        if len(nodes) < len(drop) + 2 or tried >= _MOST_TRIED:
            continue
        roles = {Role.U: U, **drop, Role.Q: Q}
        values = {role: record.of(one) for role, one in roles.items()}
        if len({len(own) for own in values.values()}) == 1:
            tried += 1
            yield roles, values


def _median(values: Floats) -> float:
    good = _good(values)
    return float(np.median(good)) if len(good) else float("-inf")


def _left_at_once(values: Mapping[Role, Floats]) -> float:
    """Return the share of the variance of Q that a law without lag and play leaves."""
    root = np.sqrt(np.abs(_drop(values)))
    return _left(values, root)


def _tells_of_dp(values: Mapping[Role, Floats]) -> bool:
    """Whether the law is worse where Δp is taken for constant: names say nothing of it."""
    with_dp = _left_at_once(values)
    return with_dp < _TELLS_DP * _left(values, np.ones(len(values[Role.Q])))


def _left(values: Mapping[Role, Floats], root: Floats) -> float:
    U, Q = values[Role.U], values[Role.Q]
    good = np.isfinite(U) & np.isfinite(Q) & np.isfinite(root)
    if good.sum() < LEAST_ROWS:
        return 1.0
    U, Q, root = U[good], Q[good], root[good]
    knots = sorted(set(quantiles(U, _KNOTS)))
    X = np.stack([root, *(root * np.maximum(U - knot, 0.0) for knot in knots)], axis=1)
    scale = np.sqrt(np.einsum("ij,ij->j", X, X)) + 1e-12
    X = X / scale
    normal = X.T @ X
    normal.flat[:: len(scale) + 1] += 1e-9
    rest = Q - X @ np.linalg.solve(normal, X.T @ Q)
    return float(rest @ rest) / max(float(np.var(Q)) * len(Q), 1e-12)


def _are_copies(roles: Assigned, record: Record, used: Sequence[Candidate]) -> bool:
    return all(copied(roles[role], record, used) is not None for role in (Role.U, Role.Q))


def copied(one: Candidate, record: Record, used: Iterable[Candidate]) -> Candidate | None:
    """Return the used signal of which a variable is a copy, in the same or in other numbers."""
    values = record.of(one)
    known = np.isfinite(values)
    if known.sum() < LEAST_ROWS or np.ptp(values[known]) == 0.0:
        return None
    for other in used:
        original = record.of(other)
        if other.node == one.node or len(original) != len(values):
            continue
        both = known & np.isfinite(original)
        if both.sum() >= LEAST_ROWS and _is_copy(original[both], values[both]):
            return other
    return None


def _is_copy(x: Floats, y: Floats) -> bool:
    """Whether N values follow others on a straight line, and those move."""
    x_about, y_about = x - x.mean(), y - y.mean()
    xx, xy, yy = float(x_about @ x_about), float(x_about @ y_about), float(y_about @ y_about)
    return xy * xy > (1.0 - _ALIKE**2) * xx * yy > 0.0 and moves(x)
