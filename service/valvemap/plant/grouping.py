"""Valves among a plant's variables: by folder, tag, loop number and code; with shared signals.

A valve has a command of its own; pressures, a flow or a temperature that no command is beside are
shared by the valves nearest to them in the hierarchy.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from valvemap.plant.candidates import Candidate
from valvemap.plant.companions import with_companions
from valvemap.plant.concepts import Concept
from valvemap.plant.place_keys import Place, by_code, by_index, by_number, by_rest, folder_of
from valvemap.plant.place_names import short_names
from valvemap.plant.roles import Role

_OWN: Final = frozenset({Role.Q, Role.QB, Role.DP, Role.P1, Role.P2, Role.PA, Role.PB})
_PRESSURES: Final = (Role.P1, Role.P2, Role.PA, Role.PB)
_OF_COMMANDS: Final = frozenset(
    {Concept.COMMAND, Concept.OPENING, Concept.SETPOINT, Concept.VALVE, Concept.SPOOL}
)
_MOST_COMPARED: Final = 4  # valves of which each is compared with the others

Key = Callable[[Candidate], Place]
Parted = Mapping[Place, tuple[list[Candidate], list[Candidate]]]


@dataclass(frozen=True)
class Unmetered:
    """A valve without a flow: its command and its pressures, or Δp."""

    name: str
    nodes: Mapping[Role, Candidate]

    @property
    def pressures(self) -> tuple[Role, ...]:
        """Roles of its pressures."""
        return (Role.DP,) if Role.DP in self.nodes else (Role.P1, Role.P2)


@dataclass(frozen=True)
class Group:
    """The variables of one valve: its own, and those it shares with others.

    ``one_meter`` are the names of all valves whose flows one meter measures together;
    ``unmetered`` are the nearest valves without a flow, which its meter may measure, too;
    ``neighbours`` the nearest other valves' variables by role. ``is_possible`` if names do not say
    that it is a valve (:mod:`possible`); ``used`` are the signals of the others then.
    """

    name: str
    own: tuple[Candidate, ...]
    shared: tuple[Candidate, ...] = ()
    one_meter: tuple[str, ...] = ()
    unmetered: tuple[Unmetered, ...] = ()
    neighbours: tuple[tuple[str, Mapping[Role, Candidate]], ...] = ()
    is_possible: bool = False
    used: tuple[Candidate, ...] = ()

    @property
    def all(self) -> tuple[Candidate, ...]:
        """Own and shared variables, but for texts."""
        return tuple(one for one in (*self.own, *self.shared) if not one.text)

    @property
    def texts(self) -> tuple[Candidate, ...]:
        """Its variables that send their numbers as texts, which cannot be monitored as numbers."""
        return tuple(one for one in (*self.own, *self.shared) if one.text)

    @property
    def watched(self) -> tuple[Candidate, ...]:
        """All variables, and those of other valves with which they are compared."""
        others = (*(one.nodes for one in self.unmetered), *(nodes for _, nodes in self.neighbours))
        known = (*self.all, *(one for nodes in others for one in nodes.values()), *self.used)
        factors = (one.companion for one in known if one.companion is not None)
        return tuple(dict.fromkeys(one for one in (*known, *factors) if not one.text))


def group(candidates: Iterable[Candidate]) -> list[Group]:
    """Return the valves' variables; variables that cannot belong to a valve are left out."""
    every = with_companions(candidates)
    relevant = [one for one in every if one.label.is_relevant]
    if not relevant:
        return []
    finer = [(folder_of, key) for key in (by_code, by_number, by_rest)]
    alone = [(key,) for key in (folder_of, by_code, by_number, by_index)]
    for keys in (alone[0], *finer, *alone[1:]):
        found = _parted(relevant, keys)
        if len(found) > 1:
            break
    else:
        usable = (keys for keys in alone[:3] if _parted(relevant, keys))
        keys = next(usable, ())
        found = _parted(relevant, keys) if keys else {}
    if not found:
        return [Group("Valve", (*relevant, *_beside(relevant, every)))]
    for other in (*alone, *finer):
        found |= _further(relevant, found, other)
    return _named(found, every, _without_flow(relevant, keys))


def _further(
    relevant: Sequence[Candidate], found: Parted, keys: Sequence[Key]
) -> dict[Place, tuple[list[Candidate], list[Candidate]]]:
    """Return the valves with a flow of their own among the variables that no valve has yet.

    A plant may write one valve in folders, and the next one in tags.
    """
    taken = {one.node for own, _ in found.values() for one in own}
    rest = [one for one in relevant if one.node not in taken]
    return {
        place: (own, shared)
        for place, (own, shared) in _parted(rest, keys).items()
        if any(place) and place not in found and _has_flow(own)
    }


def _parted(
    relevant: Sequence[Candidate], keys: Sequence[Key]
) -> dict[Place, tuple[list[Candidate], list[Candidate]]]:
    """Return own and shared variables by place, of the places that hold a whole valve."""
    return {
        place: (own, shared)
        for place, own, shared in _places(relevant, keys)
        if _is_whole([*own, *shared])
    }


def _without_flow(
    relevant: Sequence[Candidate], keys: Sequence[Key]
) -> dict[Place, Mapping[Role, Candidate]]:
    """Return command and pressures by place, of the places that lack no more than a flow."""
    found: dict[Place, Mapping[Role, Candidate]] = {}
    for place, own, shared in _places(relevant, keys):
        best = _best_by_role((*shared, *own))
        pressures = [best[role] for role in _PRESSURES if role in best]
        has_flow = bool({Role.Q, Role.QB} & set(best))
        if has_flow or not (len(pressures) > 1 or Role.DP in best):
            continue
        nodes = {Role.U: best[Role.U]}
        if len(pressures) > 1:
            found[place] = nodes | dict(zip((Role.P1, Role.P2), pressures, strict=False))
        else:
            found[place] = nodes | {Role.DP: best[Role.DP]}
    return found


def _best_by_role(variables: Sequence[Candidate]) -> dict[Role, Candidate]:
    best: dict[Role, Candidate] = {}
    for one in sorted(variables, key=lambda one: one.label.evidence[one.label.role]):
        best[one.label.role] = one
    return best


def _places(
    relevant: Sequence[Candidate], keys: Sequence[Key]
) -> Iterator[tuple[Place, list[Candidate], list[Candidate]]]:
    """Yield the places that hold a command: own variables, and those shared with others."""
    groups: dict[Place, list[Candidate]] = {}
    for one in relevant:
        place = tuple(part for key in keys for part in key(one))
        groups.setdefault(place, []).append(one)
    pool = [one for own in groups.values() if not _has_command(own) for one in own]
    for place, own in groups.items():
        if _has_command(own) and any(one.label.role in _OWN for one in own):
            yield place, own, _nearest(own, pool) if _names_command(own) else []


def _nearest(own: Sequence[Candidate], pool: Sequence[Candidate]) -> list[Candidate]:
    """Return the pool's variables of roles that the valve lacks, from the nearest folder."""
    there = {one.label.role for one in own}
    alone = [one for one in own if one.label.role in {Role.P1, Role.P2}]
    if len(alone) == 1 and min(alone[0].label.evidence[r] for r in (Role.P1, Role.P2)) > 0.0:
        there -= {Role.P1, Role.P2}  # its name says not on which side of the valve it is
    n_pressures = sum(one.label.role in _PRESSURES for one in own)
    wanted = [
        one
        for one in pool
        if one.label.role not in there
        and not (one.label.role in {Role.PA, Role.PB} and n_pressures > 1)
    ]
    if not wanted:
        return []

    best: dict[Role, int] = {}
    for one in wanted:
        best[one.label.role] = max(nearness(own[0], one), best.get(one.label.role, -1))
    return [one for one in wanted if nearness(own[0], one) == best[one.label.role]]


def nearness(one: Candidate, other: Candidate) -> int:
    """Return the number of folders that two variables have in common."""
    mine, its = one.path[:-1], other.path[:-1]
    return next(
        (n for n, (a, b) in enumerate(zip(mine, its, strict=False)) if a != b),
        min(len(mine), len(its)),
    )


def _has_command(own: Sequence[Candidate]) -> bool:
    return any(one.label.role is Role.U for one in own)


def _names_command(own: Sequence[Candidate]) -> bool:
    """Whether a name, and not the unit % alone, says that a variable is a command.

    The load of a pump is in %, too: variables beside it in other folders are not its own.
    """
    commands = (one.label.concepts for one in own if one.label.role is Role.U)
    return any(_OF_COMMANDS.intersection(found) for found in commands)


def _has_flow(own: Sequence[Candidate]) -> bool:
    return any(one.label.role in {Role.Q, Role.QB} for one in own)


def _is_whole(own: Sequence[Candidate]) -> bool:
    roles = [one.label.role for one in own]
    pressures = sum(role in _PRESSURES for role in roles)
    return Role.U in roles and _has_flow(own) and (pressures >= 2 or Role.DP in roles)


def _named(
    found: dict[Place, tuple[list[Candidate], list[Candidate]]],
    every: Sequence[Candidate],
    without_flow: Mapping[Place, Mapping[Role, Candidate]],
) -> list[Group]:
    names = short_names([*found, *without_flow])
    metered: dict[str, list[str]] = {}
    for place, (_, shared) in found.items():
        for one in shared:
            if one.label.role is Role.Q:
                metered.setdefault(one.node, []).append(names[place])
    groups = []
    for place, (own, shared) in found.items():
        others = [v for one in shared if (v := metered.get(one.node, [])) and len(v) > 1]
        together = tuple(others[0]) if others else ()
        groups.append(Group(names[place], (*own, *_beside(own, every)), tuple(shared), together))
    for place, nodes in without_flow.items():
        near = [nearness(nodes[Role.U], one.own[0]) for one in groups]
        other = Unmetered(names[place], nodes)
        groups = [
            replace(one, unmetered=(*one.unmetered, other)) if n == max(near) else one
            for one, n in zip(groups, near, strict=True)
        ]
    if len(groups) > _MOST_COMPARED:
        return groups
    signals = {one.name: _best_by_role(one.own) for one in groups}
    return [
        replace(one, neighbours=tuple((v, its) for v, its in signals.items() if v != one.name))
        for one in groups
    ]


def _beside(own: Sequence[Candidate], every: Sequence[Candidate]) -> list[Candidate]:
    """Return the recognised signals of no map, such as a spool's position, in the same folder."""
    folders = {folder_of(one) for one in own}
    nots = {Role.SPOOL, Role.PILOT, Role.POSITION, Role.SPEED}
    return [
        one
        for one in every
        if one.label.role in nots
        and one.label.evidence[one.label.role] > 0.0
        and folder_of(one) in folders
    ]
