"""Finds the valves of a foreign server: browse, watch, judge names, units, ranges and physics."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from valvemap.app.connect_answers import Wanted, check_answers, with_answers
from valvemap.app.watching import Watched, changes_of, seen_beside
from valvemap.errors import ConfigurationError, SourceRejected
from valvemap.foreign_text import printable
from valvemap.opcua_client.connection import open_connection
from valvemap.opcua_client.source_settings import SourceSettings
from valvemap.opcua_source.browsing import find_numbers
from valvemap.opcua_source.client import OpcUaSource
from valvemap.opcua_source.source_nodes import ValveNodes
from valvemap.pipeline.data_changes import DataChanges
from valvemap.plant.answers import of_valve
from valvemap.plant.candidates import Candidate
from valvemap.plant.grouping import Group, group
from valvemap.plant.mirrors import mirrors
from valvemap.plant.possible import possible_valves
from valvemap.plant.reading import Record
from valvemap.plant.unused import Unused, unused
from valvemap.plant.verdict import Verdict, judge
from valvemap.vocabulary.signals import PER_VALVE

_PER_LOT: Final = 5  # nodes watched under one name
_MOST_OF_A_VALVE: Final = 30  # variables of one valve that are watched
_MOST_TIMES: Final = 1_500  # of a record


@dataclass(frozen=True)
class Found:
    """The verdicts on a server's valves, the statistics of their nodes, and the unusable nodes.

    ``watched`` is by valve and node; ``skipped`` has a line for each unusable node or valve;
    ``unused`` are the numbers that no valve uses; ``notes`` lines about valves with equal values.
    """

    verdicts: tuple[Verdict, ...]
    watched: Mapping[str, Mapping[str, Watched]]
    skipped: tuple[str, ...] = ()
    unused: tuple[Unused, ...] = ()
    notes: tuple[str, ...] = ()

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
    groups += possible_valves(numbers, groups)
    check_answers(wanted, [one.name for one in groups])
    groups += [Group(name, ()) for name in wanted.new_valves([one.name for one in groups])]
    groups = [with_answers(one, numbers, wanted) for one in groups]
    skipped += _unusable(numbers, groups)
    every, groups = groups, [one for one in groups if one.name not in wanted.skip]
    values, refused = await _watch(settings, groups, watch_s)
    groups = [one for one in groups if one.name not in refused]
    verdicts, records = judged(groups, lambda one: record_of(values, one), wanted)
    watched = {one.valve: _statistics(one, values, watch_s) for one in verdicts}
    left = unused(numbers, every, verdicts, records) if groups else []
    notes = tuple(mirrors(verdicts, records))
    open_or_taken = (one for one in verdicts if one.reading is not None or one.question is not None)
    return Found(tuple(open_or_taken), watched, (*skipped, *refused.values()), tuple(left), notes)


def judged(
    groups: Sequence[Group], record: Callable[[Group], Record], wanted: Wanted
) -> tuple[list[Verdict], dict[str, Record]]:
    """Judge the valves, and then what may be others; return verdicts, and records by valve."""
    verdicts, records = [], {}
    used: dict[str, Candidate] = {}
    for one in sorted(groups, key=lambda one: one.is_possible):
        own = replace(one, used=tuple(used.values())) if one.is_possible else one
        given = of_valve(wanted.given, one.name, assume=wanted.assume)
        given = replace(given, ports=given.ports or one.name in wanted.ports)
        records[one.name] = record(own)
        verdict = judge(own, records[one.name], given, wanted.rating)
        verdicts.append(verdict)
        if verdict.reading is not None:
            used |= {node.node: node for node in verdict.reading.nodes.values()}
    return verdicts, records


def _unusable(numbers: Sequence[Candidate], groups: Sequence[Group]) -> list[str]:
    """Return a line for each number if no valve was found."""
    if groups:
        return []
    return [f"{printable('/'.join(n.path))}: of no valve; {printable(n.node)}" for n in numbers]


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
    """Monitor all variables; return their changes by node, and refused valves with the reason.

    A server that takes no more items watches the valves, and not what may be others.
    """
    lots, refused = _lots_of(groups)
    if not lots:
        return {}, refused
    try:
        changes = await changes_of(OpcUaSource(settings, _all(lots)), watch_s)
    except SourceRejected as error:
        sure = [one for one in groups if not one.is_possible]
        if len(sure) < len(groups):
            found, refused = await _watch(settings, sure, watch_s)
            what = f"not watched beside the others, may be a valve: {printable(str(error))}"
            rest = (one.name for one in groups if one.is_possible)
            return found, refused | {name: f"{printable(name)}: {what}" for name in rest}
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
