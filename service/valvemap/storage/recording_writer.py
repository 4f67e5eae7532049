"""Recordings as they are written: batch by batch, complete once their writer is closed."""

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from valvemap.errors import RecordingError, StorageError
from valvemap.model.samples import Samples
from valvemap.owned_files import naming
from valvemap.storage.closing import Closing
from valvemap.storage.csv_writing import csv_header, csv_rows
from valvemap.storage.packed_text import PACKINGS, packed
from valvemap.storage.recording_forms import extra_of_parquet, form_of

_BLOCK = 1 << 18
_FAILED = "cannot be written"


class RecordingWriter(Closing):
    """Writes a recording, batch by batch, as CSV or Parquet according to the file's suffix.

    Until ``close``, the rows are in ``<name>.part``, which
    :func:`~valvemap.storage.recordings.read_recording` can read, too; ``close`` renames the
    complete recording atomically. A killed process leaves its ``.part`` with every batch appended
    so far (compressed formats may lack the last 256 KiB of text); the next writer moves it to
    ``<name>.<n>.part``. Numbers read back bit-identically, times to the ns.

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
    >>> from valvemap.storage.recordings import read_recording
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
        with naming(self.path, _FAILED):
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
        with naming(self.path, _FAILED):
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Complete the recording and rename it; safe to call twice."""
        if self._file.closed:
            return
        try:
            self.flush()
        finally:
            self._file.close()
            with naming(self.path, _FAILED):
                self._form.finish(self._part, self.path)

    def discard(self) -> None:
        """Close without a recording; an existing file of that name is kept."""
        self._file.close()
        with naming(self.path, _FAILED):
            self._part.unlink(missing_ok=True)

    def _write(self) -> None:
        block = self._form.pack(bytes(self._pending))
        with naming(self.path, _FAILED):
            try:
                _write_all(self._file, block)
            except OSError:
                with suppress(OSError):  # a partial row would be joined to the next one
                    self._file.seek(self._good)
                    self._file.truncate()
                raise
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
    suffix, is_part = form_of(path)
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
    with extra_of_parquet():
        from valvemap.storage import arrow_streams as streams  # noqa: PLC0415 - an extra

    def finish(part: Path, path: Path) -> None:
        whole = path.with_name(path.name + ".whole")
        try:
            streams.parquet_from_stream(part, whole)
            os.replace(whole, path)  # noqa: PTH105 - as above
        except OSError:
            whole.unlink(missing_ok=True)
            raise
        part.unlink()

    return _Form(
        head=streams.stream_head,
        rows=streams.stream_rows,
        pack=lambda rows: rows,
        block=0,
        finish=finish,
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
