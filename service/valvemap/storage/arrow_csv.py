"""CSV parsed by Arrow (extra ``parquet``), ten times faster and to the same bits.

Arrow parses whole blocks of lines. It gets only those that it reads as :mod:`csv` and `float` do:
without quotes and brackets. A block that it rejects is parsed as text, which also finds the line
and the cell of an error.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Final, Self

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray
from pyarrow import csv

from valvemap.model.samples import Codes, Floats, Times
from valvemap.storage import columns
from valvemap.storage.arrow_columns import writable
from valvemap.storage.csv_cells import scaled_times, times_of_text
from valvemap.storage.dates import DateForm

_NANO: Final = 9  # decimals of a second in ns
_PLACES: Final = 38  # digits of a decimal of 128 bits
_TIMES: Final = (  # the first that reads all times of the first lines is taken
    *(pa.int64(), pa.decimal128(_PLACES, _NANO)),
    *(pa.timestamp("ns"), pa.timestamp("ns", "UTC")),
)
_UNLIKE: Final = ('"', "(")  # quoted cells; nan(…), which `float` rejects


class ArrowCells:
    """Cells of a block, parsed."""

    def __init__(self, table: Any, separator: str, dates: DateForm) -> None:  # noqa: ANN401 - untyped
        self._table = table
        self._separator = separator
        self._dates = dates

    def numbers(self, place: int, _name: str) -> Floats:
        """Numbers; an empty cell is NaN."""
        return writable(self._column(place))

    def times(self, place: int, seconds: float = 1.0) -> Times:
        """UTC ns; ``seconds`` is the unit of numbers."""
        column = self._column(place)
        if seconds != 1.0:
            values = writable(column)
            return scaled_times(values, values.tolist(), seconds)
        if pa.types.is_decimal(column.type):
            return _nanoseconds(column)
        if pa.types.is_string(column.type):
            return times_of_text(column.to_pylist(), self._separator, self._dates)
        ns: Times = writable(column.cast(pa.int64()))
        if pa.types.is_integer(column.type) and ns.min() < columns.NANOSECONDS_FROM:
            return columns.times_of_integers(ns)
        return ns

    def qualities(self, place: int) -> Codes:
        """Qualities."""
        encoded = self._column(place).dictionary_encode()
        codes = columns.qualities([x.lstrip(" ") for x in encoded.dictionary.to_pylist()])
        found: Codes = codes[writable(encoded.indices)]
        return found

    def names(self, place: int) -> tuple[list[str], NDArray[np.intp]]:
        """Distinct names, and the index of each row's name."""
        encoded = self._column(place).dictionary_encode()
        cells = [x.lstrip(" ") for x in encoded.dictionary.to_pylist()]
        names, index = columns.names(cells)
        return names, index[writable(encoded.indices)]

    def castable(self, places: Collection[int], kind: pa.DataType) -> bool:
        """Whether these columns of texts may be read as ``kind``: a quick look."""
        try:
            for place in places:
                trimmed = pc.utf8_trim_whitespace(self._column(place))
                pc.replace_substring(trimmed, ",", ".").cast(kind)
        except pa.ArrowException:
            return False
        return True

    def _column(self, place: int) -> Any:  # noqa: ANN401 - untyped
        column = self._table.column(str(place))
        return column.chunk(0) if column.num_chunks == 1 else column.combine_chunks()


class ArrowParser:
    """Parses blocks of lines of one file.

    Parameters
    ----------
    width
        Number of cells of a line.
    numbers, texts
        Places of the columns with numbers, and with names or qualities.
    times
        Places of the columns with times, and each one's type.
    """

    def __init__(
        self,
        width: int,
        separator: str,
        dates: DateForm,
        numbers: Collection[int],
        texts: Collection[int],
        times: Mapping[int, Any],
    ) -> None:
        self._separator, self._dates = separator, dates
        self._names = [str(place) for place in range(width)]
        self._types = dict.fromkeys(map(str, numbers), pa.float64())
        self._types |= dict.fromkeys(map(str, texts), pa.string())
        self._types |= {str(place): kind for place, kind in times.items()}

    @classmethod
    def of(
        cls,
        lines: Sequence[str],
        width: int,
        separator: str,
        dates: DateForm,
        numbers: Collection[int],
        texts: Collection[int],
        times: Collection[int],
    ) -> Self | None:
        """Return a parser of the file that begins with these lines; None if Arrow reads no such."""
        if not any(line.strip() for line in lines):
            return None
        text = "".join(lines)
        as_text = cls(width, separator, dates, numbers, texts, dict.fromkeys(times, pa.string()))
        cells = as_text.parsed(text)
        if cells is None or dates.serial:
            return as_text if cells is not None else None
        for kind in _TIMES:
            typed = cls(width, separator, dates, numbers, texts, dict.fromkeys(times, kind))
            if cells.castable(times, kind) and typed.parsed(text) is not None:
                return typed
        return as_text

    def parsed(self, text: str) -> ArrowCells | None:
        """Return the cells of whole lines; None if they must be read as text."""
        if any(mark in text for mark in _UNLIKE):
            return None
        comma = self._separator != "," and "," in text
        block = text.encode()
        try:
            table = csv.read_csv(
                pa.py_buffer(block),
                read_options=csv.ReadOptions(
                    column_names=self._names, use_threads=False, block_size=len(block) + 1
                ),
                parse_options=csv.ParseOptions(
                    delimiter=self._separator, quote_char=False, escape_char=False
                ),
                convert_options=csv.ConvertOptions(
                    check_utf8=False,
                    column_types=self._types,
                    include_columns=list(self._types),
                    null_values=[""],
                    strings_can_be_null=False,
                    decimal_point="," if comma else ".",
                ),
            )
        except pa.ArrowException:
            return None
        required = self._required()
        known = table.num_rows and all(table.column(x).null_count == 0 for x in required)
        return ArrowCells(table, self._separator, self._dates) if known else None

    def _required(self) -> list[str]:
        return [name for name, kind in self._types.items() if kind != pa.float64()]


def _nanoseconds(column: Any) -> Times:  # noqa: ANN401 - untyped
    """Return ns of decimal seconds, exact; see :func:`columns.times`."""
    words = np.frombuffer(column.buffers()[1], np.int64).reshape(-1, 2)
    words = words[column.offset : column.offset + len(column)]
    ns = words[:, 0].copy()
    if ((ns >> 63) != words[:, 1]).any() or (ns == np.iinfo(np.int64).min).any():
        return columns.times([str(x).rstrip("0").rstrip(".") for x in column.to_pylist()])
    return ns
