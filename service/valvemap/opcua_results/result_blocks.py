"""The results of all valves, written as blocks: one for each type and length of value.

The blocks hold the latest values of every valve, including valves whose nodes are not created yet.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from guarded_opcua import HardenedServer, Variable
from valvemap.model.samples import Times
from valvemap.opcua_results.information_model import (
    PARAMETERS,
    SIGNALS,
    VariableNode,
    estimator_variables,
    parameter_variables,
    signal_variables,
)
from valvemap.opcua_results.map_variables import inverse_results, line_variables
from valvemap.opcua_results.result_frames import frame_names, frame_variables
from valvemap.opcua_results.result_values import Column
from valvemap.opcua_results.valve_variables import counter_variable, health_variables
from valvemap.pipeline.nameplate import BLANK
from valvemap.pipeline.results import ValveDescription
from valvemap.vocabulary.edges import split_id

_Kind = tuple[ua.VariantType, int | None]


@dataclass(frozen=True)
class Changing:
    """A variable that changes with each result.

    ``name`` is the variable's name within the valve, ``length`` the length of its value if it is
    an array. Variables that are published side by side, in this order, share ``column``, the name
    under which they are written. ``first`` is the value before the first result; None: the
    variable is BadWaitingForInitialData until then. ``ages``: the value becomes Uncertain when its
    sample is old.
    """

    name: str
    type: ua.VariantType
    length: int | None
    column: str
    first: int | None = None
    ages: bool = True


def changing_variables(valve: ValveDescription) -> Iterator[Changing]:
    """The variables of a valve that change with each result."""
    frame, _ = frame_variables(valve)
    yield _by_itself(frame, len(frame_names(valve)))
    for estimator in valve.estimators:
        count = len(estimator.parameter_names)
        for node in estimator_variables(valve, estimator):
            if node.dimensions is None:
                yield _by_itself(node)
            elif node.kind != ua.VariantType.String and count:
                yield _by_itself(node, count)
        for node in parameter_variables(valve, estimator):
            yield _beside_others(node, f"{estimator.name}.{PARAMETERS}")
    for node in signal_variables(valve):
        yield _beside_others(node, SIGNALS)
    for node in (*inverse_results(valve), *line_variables(valve)):
        yield _by_itself(node)
    for counter in valve.counters:
        yield replace(_by_itself(counter_variable(valve.name, counter)), first=0, ages=False)
    for node in health_variables(valve.name):
        yield replace(_by_itself(node), ages=False)


class ResultBlocks:
    """Writes the variables that change with each result.

    ``now`` (UTC ns) is the source time of the values before the first result. Valves whose
    descriptions differ only in name and name plate share a layout.
    """

    def __init__(
        self, server: HardenedServer, valves: Sequence[ValveDescription], now: int
    ) -> None:
        self._server = server
        self._where: dict[str, NDArray[np.intp]] = {}  # block and column by valve; -1: none
        alike: dict[ValveDescription, list[int]] = {}
        for number, valve in enumerate(valves):
            alike.setdefault(replace(valve, name="", nameplate=BLANK), []).append(number)
        sizes: dict[_Kind, int] = {}
        aging: list[tuple[int, NDArray[np.intp], list[int]]] = []
        for described, numbers in alike.items():
            for kind, variables in _by_kind(changing_variables(described)).items():
                begin = sizes.setdefault(kind, 0)
                block, width = list(sizes).index(kind), len(variables)
                for k in reversed(range(width)):  # side by side: the column starts at the first
                    places = begin + k + width * np.arange(len(numbers))
                    if variables[k].ages:
                        aging.append((block, places, numbers))
                    for name in {variables[k].name, variables[k].column}:
                        where = self._where.setdefault(name, np.full((len(valves), 2), -1))
                        where[numbers, 0], where[numbers, 1] = block, places
                sizes[kind] += width * len(numbers)
        self._blocks = [server.add_empty_block(*kind, n) for kind, n in sizes.items()]
        self._valve_of = [np.full(n, len(valves), np.int32) for n in sizes.values()]  # if it ages
        for block, places, numbers in aging:
            self._valve_of[block][places] = numbers
        self._valves = len(valves)
        for described, numbers in alike.items():
            counters = (v for v in changing_variables(described) if v.first is not None)
            self.write(np.array(numbers), [_at_first(v, len(numbers), now) for v in counters])

    def show(self, valve: int, name: str, variable: Variable) -> None:
        """Connect a variable, given by its name within its valve, to its place in a block."""
        where = self._where.get(name)
        if where is not None and where[valve, 0] >= 0:
            block, column = where[valve].tolist()
            self._server.show(variable, self._blocks[block], column)

    def write(self, valves: Times, columns: Iterable[Column]) -> None:
        """Publish variables of valves with the same layout; skip variables without a block."""
        if not len(valves):
            return
        parts: dict[int, list[_Part]] = {}
        for column in columns:
            where = self._where.get(column.name)
            number = -1 if where is None else int(where[valves[0], 0])
            if where is None or number < 0:
                continue
            scalars = self._blocks[number].length is None
            part = _Part.of(column, where[valves, 1], scalars=scalars)
            parts.setdefault(number, []).append(part)
        for number, found in parts.items():
            places, t, codes, values = map(np.concatenate, zip(*found, strict=True))
            self._server.write_block(
                self._blocks[number], values[None], t[None], codes[None], columns=places
            )

    def doubt(self, valves: Times) -> None:
        """Mark Good values of the given valves as UncertainLastUsableValue: their sample is old."""
        doubted = np.zeros(self._valves + 1, np.bool_)
        doubted[valves] = True
        for block, valve_of in zip(self._blocks, self._valve_of, strict=True):
            columns = np.flatnonzero(doubted[valve_of])
            columns = columns[block.are_good(columns)]
            if len(columns):
                code = ua.StatusCodes.UncertainLastUsableValue
                self._server.mark_block(block, code, columns)


class Generations:
    """The blocks of valves that were added at different times; slots are never reused."""

    def __init__(self) -> None:
        self._parts: list[tuple[ResultBlocks, NDArray[np.intp]]] = []  # place by slot; -1: none
        self._slots = 0

    def add(self, server: HardenedServer, valves: Sequence[ValveDescription], now: int) -> None:
        """Add blocks for more valves, in the next slots."""
        if not valves:
            return
        count = len(valves)
        self._parts = [(one, np.append(at, np.full(count, -1))) for one, at in self._parts]
        places = np.append(np.full(self._slots, -1), np.arange(count))
        self._parts.append((ResultBlocks(server, valves, now), places))
        self._slots += count

    def keep(self, slots: Times) -> None:
        """Drop the blocks that hold none of these slots."""
        self._parts = [(one, at) for one, at in self._parts if (at[slots] >= 0).any()]

    def show(self, slot: int, name: str, variable: Variable) -> None:
        """Connect a variable to its place in a block."""
        for blocks, places in self._parts:
            if places[slot] >= 0:
                blocks.show(int(places[slot]), name, variable)

    def write(self, slots: Times, columns: Iterable[Column]) -> None:
        """Publish variables of valves with the same layout."""
        given = list(columns)
        for blocks, places in self._parts:
            own = places[slots] >= 0
            if own.all():
                blocks.write(places[slots], given)
            elif own.any():
                blocks.write(places[slots][own], (column[own] for column in given))

    def doubt(self, slots: Times) -> None:
        """Mark Good values of the valves in the given slots as Uncertain."""
        for blocks, places in self._parts:
            own = places[slots]
            blocks.doubt(own[own >= 0])


def _by_kind(variables: Iterable[Changing]) -> dict[_Kind, list[Changing]]:
    kinds: dict[_Kind, list[Changing]] = {}
    for variable in variables:
        kinds.setdefault((variable.type, variable.length), []).append(variable)
    return kinds


def _by_itself(node: VariableNode, length: int | None = None) -> Changing:
    name = _within_valve(node)
    return Changing(name, node.kind, length, name)


def _beside_others(node: VariableNode, column: str) -> Changing:
    return Changing(_within_valve(node), node.kind, None, column)


def _within_valve(node: VariableNode) -> str:
    return split_id(node.id)[1]


def _at_first(changing: Changing, valves: int, now: int) -> Column:
    return Column(
        changing.column,
        np.full(valves, changing.first),
        np.full(valves, ua.StatusCodes.Good, np.uint32),
        np.full(valves, now),
    )


class _Part(NamedTuple):
    """New values of a block: n values at n places."""

    places: NDArray[np.intp]
    t: Times
    codes: NDArray[np.uint32]
    values: NDArray[Any]

    @classmethod
    def of(cls, column: Column, first: NDArray[np.intp], *, scalars: bool) -> Self:
        """One value of each valve, or scalars side by side from the first place on."""
        if not scalars or column.values.ndim == 1:
            return cls(first, column.t, column.codes, column.values)
        width = column.values.shape[1]
        places = first[:, None] + np.arange(width)
        t = np.repeat(column.t, width)
        return cls(places.ravel(), t, column.codes.ravel(), column.values.ravel())
