"""Recordings of the rig's machines: CSV with a column for each of their signals."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import typer

from valvemap.storage.closing import Closing
from valvemap.storage.packed_text import PACKINGS, packed
from valvemap_rig.blocks import RigBlock
from valvemap_rig.machine import Machine

_BAD = 2


class MachineWriter(Closing):
    """Writes the samples of machines: ``t`` (UTC ns), ``valve``, their signals, ``quality``.

    A signal that a machine does not have, and one that was not sent, is an empty cell.
    """

    def __init__(self, path: Path, machines: Iterable[Machine]) -> None:
        packing = "".join(path.suffixes[-2:]) if path.suffix != ".csv" else ".csv"
        if packing not in PACKINGS:
            raise typer.BadParameter(
                f"{path}: a machine is recorded in a file that ends in {', '.join(PACKINGS)}"
            )
        self._packing = packing
        self._signals = [*dict.fromkeys(name for unit in machines for name in unit.signals)]
        self._file = path.open("wb")
        self._write(",".join(["t", "valve", *self._signals, "quality"]) + "\n")

    def append(self, block: RigBlock) -> None:
        """Write the samples of every machine."""
        for name, machine in block.machines.items():
            columns: list[list[str]] = []
            for signal in self._signals:
                if signal not in machine.shown:
                    columns.append([""] * len(block))
                    continue
                cells, there = machine.shown[signal].tolist(), machine.present[signal].tolist()
                columns.append(
                    [repr(x) if sent else "" for x, sent in zip(cells, there, strict=True)]
                )
            codes = np.max([status >> 30 for status in machine.status.values()], axis=0)
            quality = [str(min(code, _BAD)) for code in codes.tolist()]
            rows = zip(
                map(str, machine.t.tolist()), [name] * len(block), *columns, quality, strict=True
            )
            self._write("".join(",".join(row) + "\n" for row in rows))

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _write(self, text: str) -> None:
        self._file.write(packed(self._packing, text.encode()))
