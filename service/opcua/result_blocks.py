"""The results of all valves, written as blocks: one for each type of number."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from asyncua import ua

from service.opcua.hardened import Block, HardenedServer, Variable
from service.opcua.result_values import Shown


@dataclass
class _Row:
    """What is new of one block."""

    columns: list[int] = field(default_factory=list)
    values: list[Any] = field(default_factory=list)
    codes: list[int] = field(default_factory=list)
    t: list[int] = field(default_factory=list)


class ResultBlocks:
    """Writes what changes with each result; made once all variables are there.

    Parameters
    ----------
    server
        Where.
    scalars
        Scalar numbers.
    frames
        Arrays of Doubles, each with its length.
    """

    def __init__(
        self,
        server: HardenedServer,
        scalars: Sequence[Variable],
        frames: Sequence[tuple[Variable, int]],
    ) -> None:
        self._server = server
        self._places: dict[str, tuple[Block, int]] = {}
        for kind in sorted({variable.type for variable in scalars}):
            self._add([v for v in scalars if v.type == kind], None)
        for length in sorted({length for _, length in frames}):
            self._add([variable for variable, own in frames if own == length], length)

    def write(self, shown: Iterable[Shown]) -> list[Shown]:
        """Publish what is in a block; return the rest."""
        rest: list[Shown] = []
        rows: dict[Block, _Row] = {}
        for new in shown:
            place = self._places.get(new.id)
            if place is None:
                rest.append(new)
                continue
            row = rows.get(place[0])
            if row is None:
                row = rows[place[0]] = _Row()
            row.columns.append(place[1])
            row.values.append(0 if new.code & _BAD else new.value)
            row.codes.append(new.code)
            row.t.append(new.t)
        for block, row in rows.items():
            self._write(block, row)
        return rest

    def _write(self, block: Block, row: _Row) -> None:
        n = len(block)
        shape = (1, n) if block.length is None else (1, n, block.length)
        values = np.zeros(shape, block.dtype)
        codes = np.zeros((1, n), np.uint32)
        t = np.zeros((1, n), np.int64)
        present = np.zeros((1, n), np.bool_)
        values[0, row.columns] = np.array(row.values, block.dtype)
        codes[0, row.columns] = row.codes
        t[0, row.columns] = row.t
        present[0, row.columns] = True
        self._server.write_block(block, values, t, codes, present)

    def _add(self, variables: list[Variable], length: int | None) -> None:
        block = self._server.add_block(variables, length)
        for column, variable in enumerate(variables):
            self._places[str(variable.id.Identifier)] = block, column


_BAD = ua.StatusCodes.Bad
