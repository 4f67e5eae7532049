"""Recordings: samples of one or more valves in a file, read and written in constant memory.

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
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Protocol

from valvemap.errors import NoRecording, RecordingError, StorageError
from valvemap.model.samples import Samples
from valvemap.storage.closing import Closing
from valvemap.storage.csv_recordings import CsvReader
from valvemap.storage.csv_writing import csv_header, csv_rows
from valvemap.storage.layout import Layout, Part
from valvemap.storage.packed_text import PACKINGS, packed
from valvemap.storage.table_recordings import TableReader

_PART = re.compile(r"(\.\d+)?\.part$", re.IGNORECASE)
_BLOCK = 1 << 18


def read_recording(
    recording: object, chunk_rows: int = 65_536, layout: Layout | None = None
) -> "RecordingReader":
    """Open a recording.

    Parameters
    ----------
    recording
        Path of a ``.csv``, ``.csv.gz``, ``.csv.xz``, ``.parquet``, or of the ``.part`` of a killed
        :class:`RecordingWriter`; a data frame (pandas, polars, pyarrow; extra ``dataframes``); or
        a mapping of column names to arrays.
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
    ignored : tuple of str
        Unknown columns of the file.
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
        self.ignored = self._source.ignored

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
    suffix, is_part = _suffix(path)
    if suffix in PACKINGS:
        return CsvReader(path, suffix, chunk_rows, layout)
    from valvemap.storage import parquet_recordings as parquet  # noqa: PLC0415 - an extra

    if is_part:
        return parquet.open_stream(path, layout)
    return parquet.open_parquet(path, chunk_rows, layout)


class RecordingWriter(Closing):
    """Writes a recording, batch by batch, as CSV or Parquet according to the file's suffix.

    Until ``close``, the rows are in ``<name>.part``, which :func:`read_recording` can read, too;
    ``close`` renames the complete recording atomically. A killed process leaves its ``.part`` with
    every batch appended so far (compressed formats may lack the last 256 KiB of text); the next
    writer moves it to ``<name>.<n>.part``. Numbers read back bit-identically, times to the ns.

    Raises
    ------
    RecordingError
        if the suffix is unknown, or ``pyarrow`` is not installed.
    StorageError
        from every method, if the file cannot be written (disk full, read-only); names the file.
        Rows appended before stay readable, and appending may be retried.

    Examples
    --------
    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> with RecordingWriter(folder / "rig.csv.gz") as recording:
    ...     recording.append("Valvistor", Samples.of(t=[0], U=[50], p1=[200], p2=[100], Q=[30]))
    >>> [(valve, float(samples.Q[0])) for valve, samples in read_recording(folder / "rig.csv.gz")]
    [('Valvistor', 30.0)]
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._form = _form(self.path)
        self._part = self.path.with_name(self.path.name + ".part")
        self._pending = bytearray()
        with _naming(self.path):
            _set_aside(self._part)
            self._file = self._part.open("wb", buffering=0)
            self._good = 0
        self._pending += self._form.head()
        try:
            self._write()
        except StorageError:
            self._file.close()
            raise

    def append(self, valve: str, samples: Samples) -> None:
        """Append samples of one valve; on an error none of them is written."""
        if not len(samples):
            return
        before = len(self._pending)
        self._pending += self._form.rows(valve, samples)
        if len(self._pending) >= self._form.block:
            try:
                self._write()
            except StorageError:
                del self._pending[before:]
                raise

    def flush(self) -> None:
        """Flush all rows to the disk (fsync), so that they survive a power failure."""
        self._write()
        with _naming(self.path):
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Complete the recording and rename it; safe to call twice."""
        if self._file.closed:
            return
        try:
            self.flush()
        finally:
            self._file.close()
            with _naming(self.path):
                self._form.finish(self._part, self.path)

    def discard(self) -> None:
        """Close without a recording; an existing file of that name is kept."""
        self._file.close()
        with _naming(self.path):
            self._part.unlink(missing_ok=True)

    def _write(self) -> None:
        block = self._form.pack(bytes(self._pending))
        try:
            _write_all(self._file, block)
        except OSError as error:
            with suppress(OSError):  # a partial row would be joined to the next one
                self._file.seek(self._good)
                self._file.truncate()
            raise _storage_error(self.path, error) from error
        self._good += len(block)
        self._pending.clear()


@dataclass(frozen=True)
class _Form:
    """The write functions of one file format: append-only bytes, and completion."""

    head: Callable[[], bytes]
    rows: Callable[[str, Samples], bytes]
    pack: Callable[[bytes], bytes]
    block: int
    finish: Callable[[Path, Path], None]


def _form(path: Path) -> _Form:
    suffix, is_part = _suffix(path)
    if is_part:
        raise RecordingError(f"{path}: a recording's own name does not end in .part")
    if suffix in PACKINGS:
        return _Form(
            head=csv_header,
            rows=csv_rows,
            pack=lambda text: packed(suffix, text),
            block=0 if suffix == ".csv" else _BLOCK,
            finish=os.replace,
        )
    from valvemap.storage import parquet_recordings as parquet  # noqa: PLC0415 - an extra

    def finish(part: Path, path: Path) -> None:
        whole = path.with_name(path.name + ".whole")
        try:
            parquet.parquet_from_stream(part, whole)
            os.replace(whole, path)  # noqa: PTH105 - as above
        except OSError:
            whole.unlink(missing_ok=True)
            raise
        part.unlink()

    return _Form(
        head=parquet.stream_head,
        rows=parquet.stream_rows,
        pack=lambda rows: rows,
        block=0,
        finish=finish,
    )


def _suffix(path: Path) -> tuple[str, bool]:
    name = path.name.casefold()
    whole = _PART.sub("", name)
    for suffix in (*PACKINGS, ".parquet"):
        if whole.endswith(suffix):
            return suffix, whole != name
    if path.is_dir():
        raise NoRecording(f"{path} is a folder: name its recordings, in the order of time")
    raise NoRecording(
        f"{path} is not a recording: its name must end in {', '.join(PACKINGS)} or .parquet"
    )


def _set_aside(part: Path) -> None:
    """Rename the file of a killed writer, to keep it."""
    try:
        if part.stat().st_size == 0:
            return
    except FileNotFoundError:
        return
    name = part.name.removesuffix(".part")
    n = 1
    while (kept := part.with_name(f"{name}.{n}.part")).exists():
        n += 1
    part.rename(kept)


def _write_all(file: BinaryIO, block: bytes) -> None:
    rest = memoryview(block)
    while rest:
        rest = rest[file.write(rest) :]


class _naming:  # noqa: N801 - reads like the function that it is
    """Converts an OSError to a StorageError that names the file."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, OSError):
            raise _storage_error(self._path, error) from error


def _storage_error(path: Path, error: OSError) -> StorageError:
    return StorageError(f"{path} cannot be written: {error.strerror or error}")
