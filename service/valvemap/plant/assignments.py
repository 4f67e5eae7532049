"""Assignments of a valve's variables to roles, by their labels."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import islice, product
from typing import Final

from valvemap.plant.candidates import Candidate
from valvemap.plant.companions import factor_of, multiplied
from valvemap.plant.grouping import Group
from valvemap.plant.reading import WITH_DIFFERENCE, WITH_PRESSURES, Given, Reading, Record
from valvemap.plant.roles import Role
from valvemap.plant.scales import Scale, scales

MISSING: Final = -4.0  # nats: a required signal that is not there
NEGLIGIBLE: Final = 14.0  # nats below the best
_NO_TEMPERATURE: Final = -1.0
_MOST_ASSIGNMENTS: Final = 40


def assignments(group: Group, given: Given) -> list[tuple[Mapping[Role, Candidate], float]]:
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
        options.append([pair for pair in gains if pair[1] > best - NEGLIGIBLE])
    found: list[tuple[Mapping[Role, Candidate], float]] = []
    for pairs in islice(product(*options), 5_000):
        nodes = [one.node for one, _ in pairs if one is not None]
        if len(set(nodes)) == len(nodes):
            chosen = zip(wanted, (one for one, _ in pairs), strict=True)
            assigned = {role: one for role, one in chosen if one is not None}
            found.append((assigned, sum(gain for _, gain in pairs)))
    found.sort(key=lambda pair: -pair[1])
    return found[:_MOST_ASSIGNMENTS]


def scales_of(role: Role, node: Candidate, record: Record, given: Given) -> list[Scale]:
    """Return the readings of a variable's numbers in a role."""
    if role in given.scales:
        return [given.scales[role]]
    values = record.of(node)
    plain = scales(node, role, values, assume=given.assume)
    beside = node.companion
    factor = None if beside is None else factor_of(beside, record.of(beside))
    if beside is None or factor is None:
        return plain
    whole = replace(node, largest=None)
    product_of = scales(whole, role, values * factor, assume=given.assume)
    return multiplied(beside, factor, product_of, plain)


def lacks(nodes: Mapping[Role, Candidate]) -> bool:
    """Whether a required role has no node."""
    return bool(Reading(nodes, {}, 0.0).missing)


def _with_or_without_difference(group: Group, given: Given) -> tuple[Role, ...]:
    """Return the roles to fill: with Δp if a transmitter is there and two pressures are not."""
    has_difference = any(one.label.role is Role.DP for one in group.all)
    sides = [any(one.label.gain(role) > 0.0 for one in group.all) for role in (Role.P1, Role.P2)]
    asked = {Role.P1, Role.P2} & set(given.nodes)
    if Role.DP in given.nodes or (has_difference and not all(sides) and not asked):
        return (*WITH_DIFFERENCE, Role.T)
    return (*WITH_PRESSURES, Role.T)
