"""Finds the valves of a foreign server: browse, watch, judge names, units, ranges and physics."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from valvemap.app.watching import Watched, changes_of, seen_beside
from valvemap.errors import ConfigurationError, SourceRejected
from valvemap.foreign_text import printable
from valvemap.opcua_client.connection import open_connection
from valvemap.opcua_source.browsing import find_numbers
from valvemap.opcua_source.client import OpcUaSource, SourceSettings, ValveNodes
from valvemap.pipeline.data_changes import DataChanges
from valvemap.plant.answers import of_valve
from valvemap.plant.candidates import Candidate
from valvemap.plant.evidence import Rating
from valvemap.plant.grouping import Group, group
from valvemap.plant.reading import WITH_DIFFERENCE, WITH_PRESSURES, Given, Record
from valvemap.plant.roles import Role
from valvemap.plant.verdict import Verdict, judge
from valvemap.vocabulary.signals import PER_VALVE

_PER_LOT: Final = 5  # nodes watched under one name
_MOST_OF_A_VALVE: Final = 30  # variables of one valve that are watched
_CLEAR: Final = 3.0  # nats by which a variable is a command rather than anything else
_MOST_TIMES: Final = 1_500  # of a record


@dataclass(frozen=True)
class Wanted:
    """Answers by valve, the name plate, and valves to leave out; ``assume`` accepts our units.

    All edges of the valves ``ports`` are learnt.
    """

    given: Mapping[str, Given] = field(default_factory=dict)
    rating: Rating = field(default_factory=Rating)
    skip: frozenset[str] = frozenset()
    ports: frozenset[str] = frozenset()
    assume: bool = False

    @property
    def nodes(self) -> frozenset[str]:
        """All nodes that answers name."""
        return frozenset(node for one in self.given.values() for node in one.nodes.values())

    def new_valves(self, found: Collection[str]) -> list[str]:
        """Return the names of valves of which answers name all signals, and which were not found.

        >>> from valvemap.plant.answers import parse_answers
        >>> all_of_V2 = [f"V2.{signal}=s={signal}" for signal in ("U", "dp", "Q")]
        >>> Wanted(parse_answers([*all_of_V2, "V3.U=s=U"], ())).new_valves(["V1"])
        ['V2']
        """
        whole = [set(WITH_PRESSURES), set(WITH_DIFFERENCE)]
        return [
            name
            for name, given in self.given.items()
            if name and name not in found and any(own <= set(given.nodes) for own in whole)
        ]


@dataclass(frozen=True)
class Found:
    """The verdicts on a server's valves, the statistics of their nodes, and the unusable nodes.

    ``watched`` is by valve and node; ``skipped`` has a line for each unusable node or valve.
    """

    verdicts: tuple[Verdict, ...]
    watched: Mapping[str, Mapping[str, Watched]]
    skipped: tuple[str, ...] = ()

    @property
    def accepted(self) -> list[Verdict]:
        """Verdicts without a question."""
        return [verdict for verdict in self.verdicts if verdict.question is None]

    @property
    def open(self) -> list[Verdict]:
        """Verdicts with a question."""
        return [verdict for verdict in self.verdicts if verdict.question is not None]


async def look_around(settings: SourceSettings, watch_s: float, wanted: Wanted) -> Found:
    """Browse a server, monitor the candidates of its valves for ``watch_s``, and judge.

    Raises
    ------
    ConfigurationError
        if an answer names a valve or node that is not there.
    SourceLost, SourceRejected
    """
    connection = await open_connection(settings)
    try:
        numbers, skipped = await find_numbers(connection, wanted.nodes)
    finally:
        await connection.close()
    groups = group(numbers)
    check_answers(wanted, [one.name for one in groups])
    groups += [Group(name, ()) for name in wanted.new_valves([one.name for one in groups])]
    groups = [with_answers(one, numbers, wanted) for one in groups]
    skipped += _left_over(numbers, groups)
    groups = [one for one in groups if one.name not in wanted.skip]
    values, refused = await _watch(settings, groups, watch_s)
    verdicts, watched = [], {}
    for one in groups:
        if one.name in refused:
            continue
        given = of_valve(wanted.given, one.name, assume=wanted.assume)
        given = replace(given, ports=given.ports or one.name in wanted.ports)
        verdict = judge(one, record_of(values, one), given, wanted.rating)
        verdicts.append(verdict)
        watched[one.name] = _statistics(verdict, values, watch_s)
    return Found(tuple(verdicts), watched, (*skipped, *refused.values()))


def with_answers(one: Group, numbers: Sequence[Candidate], wanted: Wanted) -> Group:
    """Add the variables that answers name to a valve's own.

    Raises
    ------
    ConfigurationError
        if there is no such variable.
    """
    there = {candidate.node for candidate in one.all}
    more = []
    for role, node in of_valve(wanted.given, one.name).nodes.items():
        if node in there:
            continue
        named = [candidate for candidate in numbers if candidate.node == node]
        if not named:
            raise ConfigurationError(
                f"--signal {one.name}.{role}={printable(node)}: no readable number has this node"
            )
        more += named
    return replace(one, own=(*one.own, *more))


def check_answers(wanted: Wanted, names: Sequence[str]) -> None:
    """Refuse answers for valves that are not there.

    Raises
    ------
    ConfigurationError
        naming the valves that are.

    Examples
    --------
    >>> from valvemap.plant.answers import parse_answers
    >>> check_answers(  # doctest: +ELLIPSIS
    ...     Wanted(parse_answers(["V2.U=s=U"], ())), ["V1"]
    ... )
    Traceback (most recent call last):
        ...
    valvemap.errors.ConfigurationError: V2: no such valve was found; there are: V1; ...
    """
    known = {*names, *wanted.new_valves(names)}
    unknown = ({*wanted.given} - {""} | wanted.skip | wanted.ports) - known
    if unknown:
        there = ", ".join(printable(name) for name in names[:20]) or "none"
        raise ConfigurationError(
            f"{min(unknown)}: no such valve was found; there are: {there}; of a valve that is none "
            "of them, --signal names U, p1, p2 and Q, or U, dp and Q"
        )


def _left_over(numbers: Sequence[Candidate], groups: Sequence[Group]) -> Iterator[str]:
    """Yield a line for each command of no valve that was found; without valves, for each number."""
    taken = {one.node for own in groups for one in own.watched}
    for one in numbers:
        if not groups:
            yield f"{printable('/'.join(one.path))}: of no valve by its name; {printable(one.node)}"
        elif one.label.role is Role.U and one.node not in taken and one.label.gain(Role.U) > _CLEAR:
            yield (
                f"{printable('/'.join(one.path))}: a command, but its pressures or its flow were "
                f"not found; if it is a valve's, name all: --signal=NAME.U={printable(one.node)} "
                "--signal=NAME.p1=… --signal=NAME.p2=… --signal=NAME.Q=…"
            )


def record_of(values: Mapping[str, DataChanges], one: Group) -> Record:
    """Return the values of a valve's variables at the times of its most frequent signal.

    Each value is the newest at half a step past the time, so that values of one scan stamped one
    after the other are taken together.
    """
    own = {node.node: _good(values[node.node]) for node in one.watched if node.node in values}
    lengths = {node: len(changes) for node, changes in own.items()}
    if not lengths or max(lengths.values()) < 2:
        still = {node: c.value[-1:] for node, c in own.items() if len(c)}
        return Record(still or {}, 1.0)
    clock = np.unique(own[max(lengths, key=lambda node: lengths[node])].source_time)
    step = int(np.median(np.diff(clock))) if len(clock) > 1 else 10**9
    begins = max((c.source_time.min() for c in own.values() if len(c) > 1), default=clock[0])
    clock = clock[clock >= begins][-_MOST_TIMES:]
    found = {}
    for node, changes in own.items():
        order = np.argsort(changes.source_time, kind="stable")
        times, numbers = changes.source_time[order], changes.value[order]
        place = np.searchsorted(times, clock + step // 2, side="right") - 1
        if len(numbers):
            found[node] = np.where(place >= 0, numbers[np.maximum(place, 0)], np.nan)
    return Record(found, step * 1e-9)


def _good(changes: DataChanges) -> DataChanges:
    return changes[(changes.status >> 30 == 0) & np.isfinite(changes.value)]


def _statistics(
    verdict: Verdict, values: Mapping[str, DataChanges], watch_s: float
) -> dict[str, Watched]:
    if verdict.reading is None:
        return {}
    nodes = {role: node.node for role, node in verdict.reading.nodes.items()}
    own = {node: values[node] for node in nodes.values() if node in values}
    if not own:
        return {}
    clock = max(own.values(), key=len)
    scales = verdict.reading.scales
    found = {}
    for role, node in nodes.items():
        if node in own:
            scaled = replace(own[node], value=scales[role](own[node].value, role))
            found[node] = seen_beside(scaled, clock, watch_s)
    return found


async def _watch(
    settings: SourceSettings, groups: Sequence[Group], watch_s: float
) -> tuple[dict[str, DataChanges], dict[str, str]]:
    """Monitor all variables; return their changes by node, and refused valves with the reason."""
    lots, refused = _lots_of(groups)
    if not lots:
        return {}, refused
    try:
        changes = await changes_of(OpcUaSource(settings, _all(lots)), watch_s)
    except SourceRejected:
        refused |= await _refused_of(settings, lots)
        lots = {name: own for name, own in lots.items() if name not in refused}
        if not lots:
            raise
        changes = await changes_of(OpcUaSource(settings, _all(lots)), watch_s)
    return _by_node(changes, _all(lots)), refused


async def _rejection(settings: SourceSettings, lots: Sequence[ValveNodes]) -> SourceRejected | None:
    """Return why the server takes these variables not, None if it does."""
    try:
        await changes_of(OpcUaSource(settings, lots), 0.0)
    except SourceRejected as error:
        return error
    return None


async def _refused_of(
    settings: SourceSettings, lots: Mapping[str, Sequence[ValveNodes]]
) -> dict[str, str]:
    """Return the valves whose variables the server does not take, with the reason."""
    errors = {name: await _rejection(settings, own) for name, own in lots.items()}
    return {
        name: f"{printable(name)}: {printable(str(error))}"
        for name, error in errors.items()
        if error is not None
    }


def _lots_of(
    groups: Sequence[Group],
) -> tuple[dict[str, list[ValveNodes]], dict[str, str]]:
    """Return the lots of each valve, and the valves whose nodes cannot be read."""
    lots: dict[str, list[ValveNodes]] = {}
    refused: dict[str, str] = {}
    for one in groups:
        try:
            lots[one.name] = list(_lots(one))
        except ConfigurationError as error:
            refused[one.name] = f"{printable(one.name)}: {printable(str(error))}"
    return lots, refused


def _lots(one: Group) -> Iterator[ValveNodes]:
    """Yield a valve's variables in lots as the source client reads them, without scaling."""
    nodes = [candidate.node for candidate in one.watched[:_MOST_OF_A_VALVE]]
    for start in range(0, len(nodes), _PER_LOT):
        lot = nodes[start : start + _PER_LOT]
        U, p1, p2, Q = (*lot, *[lot[-1]] * 3)[:4]
        T = lot[4] if len(lot) == _PER_LOT else None
        yield ValveNodes(one.name, U, p1, p2, Q, T, insist=True)


def _all(lots: Mapping[str, Sequence[ValveNodes]]) -> list[ValveNodes]:
    return [lot for own in lots.values() for lot in own]


def _by_node(changes: DataChanges, lots: Sequence[ValveNodes]) -> dict[str, DataChanges]:
    found: dict[str, DataChanges] = {}
    order = np.argsort(changes.item, kind="stable")
    items = changes.item[order]
    for number, lot in enumerate(lots):
        for signal, _, node in lot.signals():
            item = number * PER_VALVE + signal
            low, high = np.searchsorted(items, [item, item + 1])
            if node not in found or len(found[node]) < high - low:
                found[node] = changes[order[low:high]]
    return found
