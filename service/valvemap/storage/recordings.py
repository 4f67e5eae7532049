"""Recordings: samples of one or more valves in a file, read in constant memory.

A recording is CSV (``.csv``, compressed ``.csv.gz`` or ``.csv.xz``) or Parquet (``.parquet``, extra
``parquet``) with the columns below, in any order; other columns are ignored.

=========  ========================================================================================
column     holds
=========  ========================================================================================
``t``      source time: ISO 8601 (without an offset it is UTC), an integer >= 1e15 = UTC ns, any
           other number = s; exact to the ns. A Parquet timestamp of any unit.
``U``      control voltage, %
``p1``     pressure upstream of the valve, bar
``p2``     pressure downstream of the valve, bar
``Q``      flow, l/min
``T``      oil temperature, °C (optional)
``valve``  name of the valve (optional, else ``Valvistor``)
``quality``  0, 1, 2, or a word beginning with Good, Uncertain, Bad, or an OPC UA status code
           (optional, else Good)
=========  ========================================================================================

Headings are case-insensitive. A heading may have a unit: ``p1 [psi]``, ``Q (gpm)``, ``T_degF``;
without one the units above apply. Other names, units and raw ranges are configured with a
:class:`~valvemap.storage.layout.Layout`.

An empty cell and ``nan`` are missing numbers: valid data, which the quality gate judges. CSV is
UTF-8, UTF-16 or cp1252, with the separator of its header: comma, semicolon, tab or bar. A comma in
a number is the decimal comma (German locale), unless the file's other numbers show that it groups
digits: 1.234,5 and 1,234.5, 1 234,5 and 1'234.5 are numbers. Dates may have a spreadsheet's format,
31.12.2026 13:45:10,5 or 12/31/2026 1:45:10 PM or days since 1900, if day and month are unambiguous.
Dates and times of day may be two columns; times of day alone begin at the first midnight.
"""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from valvemap.errors import RecordingError
from valvemap.model.samples import Samples
from valvemap.storage.closing import Closing
from valvemap.storage.csv_recordings import CsvReader
from valvemap.storage.layout import Layout, Part
from valvemap.storage.packed_text import PACKINGS
from valvemap.storage.recording_forms import extra_of_parquet, form_of
from valvemap.storage.table_recordings import TableReader


def read_recording(
    recording: object, chunk_rows: int = 65_536, layout: Layout | None = None
) -> "RecordingReader":
    """Open a recording.

    Parameters
    ----------
    recording
        Path of a ``.csv``, ``.csv.gz``, ``.csv.xz``, ``.parquet``, or of the ``.part`` of a killed
        :class:`~valvemap.storage.recording_writer.RecordingWriter`; a data frame (pandas, polars,
        pyarrow; extra ``dataframes``); or a mapping of column names to arrays.
    chunk_rows
        Rows held in memory at a time.
    layout
        Columns and units that differ from those above.

    Returns
    -------
    RecordingReader
        An iterator of (valve, :class:`~valvemap.model.samples.Samples`), with the rows of each
        valve in the order of the file.

    Raises
    ------
    RecordingError
        here or while iterating: one line that names file, line, column, value and the allowed
        values. The samples before the damage of a truncated file are yielded first.
    ConfigurationError
        if the file's headings contradict ``layout``.
    """
    return RecordingReader(recording, chunk_rows, layout or Layout())


class RecordingReader(Closing, Iterator[tuple[str, Samples]]):
    """Iterates over a recording; see :func:`read_recording`.

    Attributes
    ----------
    name : str
        The file, or the type of the data frame.
    parts : tuple of Part
        Columns of each valve; of a file in long format once its first samples are there.
    """

    def __init__(self, recording: object, chunk_rows: int, layout: Layout) -> None:
        if isinstance(recording, str | os.PathLike):
            self.name = os.fspath(recording)
            self._source: _Source = _open(Path(recording), chunk_rows, layout)
        else:
            table = TableReader(recording, chunk_rows, layout)
            self.name, self._source = table.name, table
        self._chunks = self._source.chunks()
        self._seen = False

    @property
    def ignored(self) -> tuple[str, ...]:
        """Unknown columns of the file; of one in long format once its first samples are there."""
        return self._source.ignored

    @property
    def fraction(self) -> float:
        """The fraction of the file read, 0 to 1, for a progress bar."""
        return self._source.fraction

    @property
    def parts(self) -> tuple[Part, ...]:
        """Columns of each valve."""
        return self._source.parts

    def close(self) -> None:
        """Close the file; iteration ends."""
        self._source.close()
        self._chunks = iter(())
        self._seen = True

    def __next__(self) -> tuple[str, Samples]:
        try:
            chunk = next(self._chunks)
        except BaseException as error:
            empty = isinstance(error, StopIteration) and not self._seen
            self.close()
            if empty:
                raise RecordingError(f"{self.name} holds no samples") from None
            raise
        self._seen = True
        return chunk


class _Source(Protocol):
    """An open file of one format."""

    ignored: tuple[str, ...]

    @property
    def fraction(self) -> float: ...

    @property
    def parts(self) -> tuple[Part, ...]: ...

    def chunks(self) -> Iterator[tuple[str, Samples]]: ...

    def close(self) -> None: ...


def _open(path: Path, chunk_rows: int, layout: Layout) -> _Source:
    suffix, is_part = form_of(path)
    if suffix in PACKINGS:
        return CsvReader(path, suffix, chunk_rows, layout)
    with extra_of_parquet():
        from valvemap.storage.arrow_streams import open_stream  # noqa: PLC0415 - an extra
        from valvemap.storage.parquet_recordings import open_parquet  # noqa: PLC0415
    if is_part:
        return open_stream(path, layout)
    return open_parquet(path, chunk_rows, layout)
