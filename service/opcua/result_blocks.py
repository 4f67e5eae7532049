"""The results of all valves, written as blocks: one for each type and length of value."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from service.hardened import Block, HardenedServer, Variable
from service.identification.samples import Times
from service.opcua.result_values import Column


@dataclass(frozen=True)
class Place:
    """A variable that changes with each result.

    ``valve`` is its number, ``name`` the variable's within the valve, ``length`` that of its value
    if it is an array. One without a name stands beside the one before it, and is written with it.
    """

    valve: int
    name: str | None
    variable: Variable
    length: int | None


class ResultBlocks:
    """Writes what changes with each result; made once all variables are there."""

    def __init__(self, server: HardenedServer, valves: int, places: Iterable[Place]) -> None:
        self._server = server
        self._blocks: list[Block] = []
        self._where: dict[str, NDArray[np.intp]] = {}  # block and column by valve; -1: none
        kinds: dict[tuple[ua.VariantType, int | None], list[Place]] = {}
        for place in places:
            kinds.setdefault((place.variable.type, place.length), []).append(place)
        for (_, length), own in kinds.items():
            for column, place in enumerate(own):
                if place.name is None:
                    continue
                where = self._where.setdefault(place.name, np.full((valves, 2), -1))
                where[place.valve] = len(self._blocks), column
            self._blocks.append(server.add_block([place.variable for place in own], length))

    def write(self, valves: Times, columns: Iterable[Column]) -> None:
        """Publish variables of valves that are treated alike; what is not there is passed over."""
        if not len(valves):
            return
        rows: dict[int, _Row] = {}
        for column in columns:
            where = self._where.get(column.name)
            number = -1 if where is None else int(where[valves[0], 0])
            if where is None or number < 0:
                continue
            if number not in rows:
                rows[number] = _Row(self._blocks[number])
            places = where[valves, 1]
            if len(places) == 1:  # writing to a slice is much the faster
                places = slice(places[0], places[0] + 1)
            rows[number].put(places, column)
        for row in rows.values():
            self._server.write_block(row.block, row.values, row.t, row.codes, row.present)


class _Row:
    """What is new of one block."""

    def __init__(self, block: Block) -> None:
        n = len(block)
        self.block = block
        shape = (1, n) if block.length is None else (1, n, block.length)
        self.values = np.zeros(shape, block.dtype)
        self.codes = np.zeros((1, n), np.uint32)
        self.t = np.zeros((1, n), np.int64)
        self.present = np.zeros((1, n), np.bool_)

    def put(self, places: NDArray[np.intp] | slice, column: Column) -> None:
        if self.block.length is None and column.values.ndim == 2:
            self._put_side_by_side(places, column)
            return
        self.values[0, places] = column.values
        self.codes[0, places] = column.codes
        self.t[0, places] = column.t
        self.present[0, places] = True

    def _put_side_by_side(self, places: NDArray[np.intp] | slice, column: Column) -> None:
        first = np.array([places.start]) if isinstance(places, slice) else places
        each = first[:, None] + np.arange(column.values.shape[1])
        self.values[0, each] = column.values
        self.codes[0, each] = column.codes
        self.t[0, each] = column.t[:, None]
        self.present[0, each] = True
