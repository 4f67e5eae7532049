"""Units of the source: conversion to our units, and checks against the node properties."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from asyncua import ua

from valvemap.errors import SourceRejected
from valvemap.opcua_client.connection import Connection
from valvemap.opcua_client.requests import read_properties
from valvemap.opcua_client.source_errors import in_one_line
from valvemap.opcua_source.checked_nodes import CheckedNodes
from valvemap.opcua_source.source_nodes import LOAD, REQUIRED_U, ValveNodes, copies_of, wanted_nodes
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.units import (
    QUANTITY_OF,
    UNECE,
    Measure,
    Quantity,
    Unit,
    inside,
    relative,
    unit_by_number,
    unit_of,
)
from valvemap.vocabulary.signals import MEASURED, PER_VALVE, Signal

_PROPERTIES: Final = ("EngineeringUnits", "EURange")
_SLACK: Final = 0.01  # of a range: rounding in its configuration
_ELECTRICAL_SPANS: Final = ((4.0, 20.0), (0.0, 20.0), (0.0, 10.0), (-10.0, 10.0), (0.0, 5.0))


class Scales:
    """Hands the changes of a shared node to all its items, in their internal units."""

    def __init__(self, valves: Sequence[ValveNodes]) -> None:
        n = len(valves) * PER_VALVE
        self._gain, self._offset = np.ones(n), np.zeros(n)
        for number, valve in enumerate(valves):
            for place, name in enumerate(MEASURED):
                scaling = valve.measure(valve.source_of(name)).scaling(name)
                item = number * PER_VALVE + place
                self._gain[item], self._offset[item] = scaling.gain, scaling.offset
        self._has_none = bool((self._gain == 1.0).all() and (self._offset == 0.0).all())
        differences = [number for number, valve in enumerate(valves) if valve.dp is not None]
        self._dp_items = np.array(differences, np.int32) * PER_VALVE + Signal.P1
        copies = copies_of(valves)
        self._times = np.ones(n + 1, np.int64)  # items of an item's node; last: of an unknown item
        for item, own in copies.items():
            self._times[item] += len(own)
        self._of_node = {item: np.array([item, *own], np.int32) for item, own in copies.items()}

    def __call__(self, changes: DataChanges) -> DataChanges:
        """Return the changes in internal units; the same object if no signal needs conversion."""
        if self._of_node:
            changes = self._to_all(changes)
        if len(self._dp_items):
            changes = self._with_zeros(changes)
        if self._has_none:
            return changes
        gain, offset = self._gain[changes.item], self._offset[changes.item]
        own = (gain == 1.0) & (offset == 0.0)
        return replace(changes, value=np.where(own, changes.value, changes.value * gain + offset))

    def _to_all(self, changes: DataChanges) -> DataChanges:
        """Repeat each change of a shared node for all items of the node."""
        unknown = (changes.item < 0) | (changes.item >= len(self._gain))
        times = self._times[np.where(unknown, -1, changes.item)]
        found = changes[np.repeat(np.arange(len(changes)), times)]
        begins = np.cumsum(times) - times
        item = found.item.copy()
        for first, items in self._of_node.items():
            rows = begins[changes.item == first]
            for k, one in enumerate(items):
                item[rows + k] = one
        return replace(found, item=item)

    def _with_zeros(self, changes: DataChanges) -> DataChanges:
        """Add p2 = 0 behind each change of a Δp transmitter, with its time and status."""
        is_dp = np.isin(changes.item, self._dp_items)
        rows = np.repeat(np.arange(len(changes)), np.where(is_dp, 2, 1))
        added = np.zeros(len(rows), np.bool_)
        added[1:] = rows[1:] == rows[:-1]
        found = changes[rows]
        item = np.where(added, found.item + (Signal.P2 - Signal.P1), found.item)
        return replace(found, item=item.astype(np.int32), value=np.where(added, 0.0, found.value))


@dataclass(frozen=True)
class SaidOfNode:
    """The properties of a node: its unit, the symbol as sent, and its EURange."""

    unit: Unit | None = None
    symbol: str = ""
    bounds: tuple[float, float] | None = None


async def check_units(
    connection: Connection, valves: Sequence[ValveNodes], nodes: CheckedNodes
) -> None:
    """Compare the nodes' EngineeringUnits and EURange with the configuration.

    Nodes without these properties pass, as do servers that cannot translate browse paths.

    Raises
    ------
    SourceRejected
        if a node contradicts its configuration; names the first one.
    SourceLost
    """
    wanted = list(_wanted(valves, nodes))
    said = await read_units(connection, [node for _, _, node, _ in wanted])
    faults = dict[str, None]()  # each once, however many edges read the node
    for (valve, name, _, label), of_node in zip(wanted, said, strict=True):
        fault = contradiction(name, valves[valve].measure(name), of_node)
        if fault is not None and not valves[valve].insist:
            said_so = (
                f"{label} {fault} (signals.{valves[valve].word(name)} of "
                f"{valves[valve].title}; insist = true takes it as it is)"
            )
            faults[said_so] = None
    if faults:
        more = f" (and {len(faults) - 1} more nodes)" if len(faults) > 1 else ""
        raise SourceRejected(next(iter(faults)) + more)


def contradiction(name: str, measure: Measure, said: SaidOfNode) -> str | None:
    """Return how a node contradicts its configuration, as the end of a sentence; None if not.

    >>> contradiction("p1", Measure(), SaidOfNode(unit_of("psi")))
    "comes in psi, configured is bar: set unit = 'psi'"
    """
    return _of_unit(name, measure, said.unit) or _of_range(name, measure, said)


def _of_unit(name: str, measure: Measure, said: Unit | None) -> str | None:
    unit = measure.unit or inside(QUANTITY_OF[name])
    quantity = unit.quantity
    if said is None:
        return None
    if measure.raw is not None:
        is_raw = said.quantity in {Quantity.ELECTRICAL, Quantity.OPENING}  # or a share of the range
        what = f"comes in {said.symbol}, configured is a raw range: leave raw and range out"
        return None if is_raw else what
    if said.quantity is Quantity.ELECTRICAL:
        return f"comes in {said.symbol}: raw and range must say what it means"
    if said.quantity is not quantity:
        return f"comes in {said.symbol}, a unit of {said.quantity.noun}; is it the right node?"
    what = f"comes in {said.symbol}, configured is {unit.symbol}: set unit = '{said.symbol}'"
    return None if said == unit else what


def _of_range(name: str, measure: Measure, said: SaidOfNode) -> str | None:
    if said.bounds is None:
        return None
    low, high = said.bounds
    shown = f"[{low:g}, {high:g}]"
    if measure.raw is not None:
        if measure.scaled is not None and said.bounds == tuple(measure.scaled):
            return None  # the range is that of the scaled values
        slack = _SLACK * (high - low)
        if min(measure.raw) < low - slack or max(measure.raw) > high + slack:
            return f"has the range {shown}, configured is raw = {list(measure.raw)}"
        return None
    is_electrical = said.unit is None and said.bounds in _ELECTRICAL_SPANS
    if name in {"U", REQUIRED_U} and measure.unit is None and is_electrical:
        return f"has the range {shown}, which is no %: raw = {shown}, range = [0, 100]"
    return None


async def read_units(connection: Connection, nodes: Sequence[ua.NodeId]) -> list[SaidOfNode]:
    """Read EngineeringUnits and EURange of nodes; missing properties give empty fields.

    Raises
    ------
    SourceLost, SourceRejected
    """
    with connection.errors("reading units"):
        try:
            pairs = await read_properties(connection, nodes, _PROPERTIES)
        except ua.UaStatusCodeError:
            return [SaidOfNode() for _ in nodes]
    return [_said(information, bounds) for information, bounds in pairs]


def _wanted(
    valves: Sequence[ValveNodes], nodes: CheckedNodes
) -> Iterator[tuple[int, str, ua.NodeId, str]]:
    copies = copies_of(valves)
    labels = {wanted.item: wanted.label for wanted in wanted_nodes(valves)}
    for node in nodes.monitored:
        for item in (node.item, *copies.get(node.item, ())):
            valve, signal = divmod(item, PER_VALVE)
            if signal < len(MEASURED):
                name = valves[valve].source_of(MEASURED[signal])
                yield valve, name, node.node, labels[item]
    for number in range(len(valves)):
        for role in (REQUIRED_U, LOAD):
            command = nodes.writable.get((number, role))
            if command is not None:
                yield number, role, command.node, command.label


def _said(information: object, bounds: object) -> SaidOfNode:
    unit, symbol, span = None, "", None
    if isinstance(information, ua.EUInformation):
        symbol = in_one_line(information.DisplayName.Text or "")
        if information.NamespaceUri in {UNECE, "", None}:
            unit = unit_by_number(information.UnitId)
        by_symbol = unit_of(symbol)
        if unit is None or (by_symbol is not None and relative(by_symbol) == unit):
            unit = by_symbol  # no number stands for an absolute pressure
    if isinstance(bounds, ua.Range) and np.isfinite([bounds.Low, bounds.High]).all():
        span = (float(bounds.Low), float(bounds.High)) if bounds.Low < bounds.High else None
    return SaidOfNode(unit, symbol, span)
