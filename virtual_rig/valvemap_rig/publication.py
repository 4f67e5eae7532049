"""Blocks of samples as columns of the server's blocks, and their publication."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from guarded_opcua import HardenedServer
from valvemap_rig.blocks import RigBlock, ValveBlock
from valvemap_rig.information_model import FleetNodes, RigNodes
from valvemap_rig.machine_simulation import MachineBlock
from valvemap_rig.records import Floats

_Unit = TypeVar("_Unit", ValveBlock, MachineBlock)

NOTHING = RigBlock(np.empty(0, np.uint32), np.empty(0, np.int64), {})


@dataclass(frozen=True)
class Columns:
    """A block of n samples, in the layout of the server's blocks.

    ``values``, ``times``, ``codes`` and ``present`` have a column for each signal of each valve and
    machine, ``sequences`` and ``t`` one for each. The signals of a sample share their timestamp.
    """

    values: Floats
    times: NDArray[np.int64]
    codes: NDArray[np.uint32]
    present: NDArray[np.bool_]
    sequences: NDArray[np.int64]
    t: NDArray[np.int64]


def columns_of(block: RigBlock, sequence_offset: int) -> Columns:
    """Convert a whole block to columns, of which single rows can be published."""
    units: list[ValveBlock | MachineBlock] = [*block.valves.values(), *block.machines.values()]
    t = np.stack([unit.t for unit in units], axis=1)
    sequence = (block.sequence.astype(np.int64) + sequence_offset) % 2**32
    every = [(unit, signal) for unit in units for signal in unit.status]
    return Columns(
        values=_columns([unit.column(signal) for unit, signal in every]),
        times=_columns([unit.t for unit, _ in every]),
        codes=_columns([unit.quality(signal)[0] for unit, signal in every]),
        present=_columns([unit.quality(signal)[1] for unit, signal in every]),
        sequences=np.repeat(sequence[:, None], len(units), axis=1),
        t=t,
    )


def publish(server: HardenedServer, nodes: RigNodes, columns: Columns, rows: slice) -> None:
    """Publish the given rows of a block.

    Signals that are not present are skipped; ``Sequence`` is always published.
    """
    server.write_block(
        nodes.signals,
        columns.values[rows],
        columns.times[rows],
        columns.codes[rows],
        columns.present[rows],
    )
    server.write_block(nodes.sequences, columns.sequences[rows], columns.t[rows])


def publish_fleet(
    server: HardenedServer, nodes: FleetNodes, samples: Floats, start: int, t: NDArray[np.int64]
) -> None:
    """Publish samples (n, valves, 5); the first has the number ``start``."""
    n, count = samples.shape[:2]
    server.write_block(nodes.signals, samples.reshape(n, -1), t)
    sequence = np.arange(start, start + n) % 2**32
    server.write_block(nodes.sequences, np.repeat(sequence[:, None], count, axis=1), t)


def part(block: RigBlock, start: int, stop: int) -> RigBlock:
    """Return samples ``start`` to ``stop`` of a block, as views."""
    if start == 0 and stop == len(block):
        return block
    chosen = slice(start, stop)
    return RigBlock(
        block.sequence[chosen],
        block.t[chosen],
        {name: _cut_unit(valve, chosen) for name, valve in block.valves.items()},
        {name: _cut_unit(machine, chosen) for name, machine in block.machines.items()},
    )


def _columns(arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
    return np.stack(arrays, axis=1)


def _cut_unit(unit: _Unit, chosen: slice) -> _Unit:
    columns = {field.name: _cut(getattr(unit, field.name), chosen) for field in fields(unit)}
    return replace(unit, **columns)


def _cut(column: Any, chosen: slice) -> Any:  # noqa: ANN401 - an array, or arrays by signal
    if isinstance(column, Mapping):
        return {signal: array[chosen] for signal, array in column.items()}
    return column[chosen]
