"""Recordings as text: CSV, plain or packed by gzip or xz."""

import csv
import gzip
import io
import lzma
import os
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import IO, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from service.errors import RecordingError
from service.identification.samples import Floats, Samples
from service.storage import columns
from service.storage.columns import CellError

PACKINGS = (".csv", ".csv.gz", ".csv.xz")

_HEADER_LIMIT = 65_536
_SEPARATORS = {",": "comma", ";": "semicolon", "\t": "tab"}
_DAMAGE = (EOFError, zlib.error, lzma.LZMAError, gzip.BadGzipFile, csv.Error)

_BLOCK = 2_048  # lines whose cells stay in the processor's cache: nearly twice the speed

Rows = list[list[str]]
Block = tuple[Samples, NDArray[np.intp]]


class CsvReader:
    """Reads a recording of one of :data:`PACKINGS` chunk by chunk.

    Separated by comma, semicolon or tab, as the header is; behind a semicolon or tab the decimal
    comma is understood, too. UTF-8, with or without a byte order mark; any line ends.
    """

    def __init__(self, path: Path, packing: str, chunk_rows: int) -> None:
        self._path = path
        self._rows = chunk_rows
        with _Faults(path, lambda: 0):
            self._raw = path.open("rb")
            self._size = os.fstat(self._raw.fileno()).st_size
        unpacked = _unpacked(self._raw, packing)
        self._text = io.TextIOWrapper(unpacked, encoding="utf-8-sig", newline="")
        try:
            self._separator, self._header = self._read_header()
        except RecordingError:
            self.close()
            raise
        self.ignored = tuple(name for name in self._header if name not in columns.COLUMNS)
        self._valves: dict[str, int] = {}
        self._lines = csv.reader(self._text, delimiter=self._separator, skipinitialspace=True)

    @property
    def fraction(self) -> float:
        """How much of the file's bytes have been read, 0 to 1."""
        return 1.0 if self._raw.closed else min(self._raw.tell() / self._size, 1.0)

    def close(self) -> None:
        """Close the file."""
        with suppress(*_DAMAGE, OSError):  # it was only read
            self._text.close()
        self._raw.close()

    def _read_header(self) -> tuple[str, list[str]]:
        with _Faults(self._path, lambda: 0):
            line = self._text.readline(_HEADER_LIMIT)
        if not line:
            raise RecordingError(f"{self._path} is empty: a recording begins with t,U,p1,p2,Q")
        separator = max(_SEPARATORS, key=line.count)
        found = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
        header = [name.strip() for name in found]
        _check(header, self._path)
        return separator, header

    def chunks(self) -> Iterator[tuple[str, Samples]]:
        """Yield (valve, samples), so many lines at a time.

        What stands before damage is handed out before the damage is raised.
        """
        more, problem = True, None
        while more:
            blocks: list[Block] = []
            left = self._rows
            while more and left:
                limit, before = min(left, _BLOCK), self._lines.line_num + 1
                rows, problem = self._read(limit)
                blocks += self._parsed(rows, before)
                left -= len(rows)
                more = len(rows) == limit and problem is None
            if blocks:
                samples, index = zip(*blocks, strict=True)
                whole = Samples.concatenate(samples)
                yield from columns.by_valve(whole, list(self._valves), np.concatenate(index))
        if problem is not None:
            raise problem

    def _read(self, limit: int) -> tuple[Rows, RecordingError | None]:
        """Lines up to ``limit``, and what stopped them before."""
        rows: Rows = []
        try:
            with _Faults(self._path, lambda: self._lines.line_num + 1):
                rows.extend(islice(self._lines, limit))  # keeps what came before a fault
        except RecordingError as error:
            return rows, error
        return rows, None

    def _parsed(self, rows: Rows, before: int) -> list[Block]:
        """Samples and their valves' numbers; none where all lines are blank."""
        lines: Sequence[int] = range(before + 1, before + 1 + len(rows))
        if set(map(len, rows)) != {len(self._header)}:
            lines, rows = self._without_blank_lines(lines, rows)
        if not rows:
            return []
        cells = dict(zip(self._header, zip(*rows, strict=True), strict=True))
        try:
            samples = self._samples(cells)
            names, index = columns.names(cells.get("valve", (columns.DEFAULT_VALVE,) * len(rows)))
        except CellError as error:
            raise RecordingError(f"{self._path}, line {lines[error.row]}: {error}") from None
        numbers = [self._valves.setdefault(name, len(self._valves)) for name in names]
        return [(samples, np.array(numbers)[index])]

    def _samples(self, cells: Mapping[str, Sequence[str]]) -> Samples:
        def points(name: str) -> Sequence[str]:
            if self._separator == ",":
                return cells[name]
            return [cell.replace(",", ".") for cell in cells[name]]

        def number(name: str) -> Floats:
            return columns.numbers(points(name), name)

        return Samples.of(
            t=columns.times(points("t")),
            U=number("U"),
            p1=number("p1"),
            p2=number("p2"),
            Q=number("Q"),
            T=number("T") if "T" in cells else None,
            quality=columns.qualities(cells["quality"]) if "quality" in cells else None,
        )

    def _without_blank_lines(
        self, numbers: Sequence[int], rows: Rows
    ) -> tuple[Sequence[int], Rows]:
        kept = [(number, row) for number, row in zip(numbers, rows, strict=True) if row]
        for number, row in kept:
            if len(row) != len(self._header):
                raise RecordingError(
                    f"{self._path}, line {number}: {len(row)} cells separated by "
                    f"{_SEPARATORS[self._separator]} where the header has {len(self._header)}"
                )
        return [number for number, _ in kept], [row for _, row in kept]


class _Faults:
    """Turns what reading text can raise into one sentence."""

    def __init__(self, path: Path, line: Callable[[], int]) -> None:
        self._path = path
        self._line = line

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, UnicodeDecodeError):
            raise RecordingError(
                f"{self._path} is not a recording: no UTF-8 text behind line {self._line()}"
            ) from None
        if isinstance(error, _DAMAGE):
            raise RecordingError(
                f"{self._path} is cut off or damaged behind line {self._line()}: {error}"
            ) from None
        if isinstance(error, FileNotFoundError):
            raise RecordingError(f"{self._path} does not exist") from None
        if isinstance(error, OSError):
            raise RecordingError(
                f"{self._path} cannot be read: {error.strerror or error}"
            ) from error


def csv_rows(valve: str, samples: Samples) -> bytes:
    r"""Write samples as lines of text which read back as the same bits.

    >>> csv_rows("V1", Samples.of(t=[10**15], U=[0.1], p1=[200], p2=[1e-9], Q=[30]))
    b'1000000000000000,0.1,200.0,1e-09,30.0,nan,V1,0\n'
    """
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(
        zip(
            map(columns.time_text, samples.t.tolist()),
            *(getattr(samples, name).tolist() for name in columns.NUMBERS),
            (valve,) * len(samples),
            samples.quality.tolist(),
            strict=True,
        )
    )
    return text.getvalue().encode()


def csv_header() -> bytes:
    """Return the header line that :func:`csv_rows` fits to."""
    return (",".join(columns.COLUMNS) + "\n").encode()


def packed(packing: str, text: bytes) -> bytes:
    """Pack text so that it can be appended: a gzip member or an xz stream of its own."""
    match packing:
        case ".csv.gz":
            return gzip.compress(text, compresslevel=6, mtime=0)
        case ".csv.xz":
            return lzma.compress(text, preset=3)
        case _:
            return text


def _unpacked(raw: BinaryIO, packing: str) -> IO[bytes]:
    match packing:
        case ".csv.gz":
            return cast("IO[bytes]", gzip.GzipFile(fileobj=raw))
        case ".csv.xz":
            return lzma.LZMAFile(raw)
        case _:
            return raw


def _check(header: Sequence[str], path: Path) -> None:
    missing = [name for name in columns.REQUIRED if name not in header]
    if missing:
        found = ",".join(header)
        raise RecordingError(
            f"{path}, line 1: column {', '.join(missing)} is missing; the header must hold "
            f"t,U,p1,p2,Q (and may hold T, valve, quality), found {found[:60]!r}"
        )
    twice = [name for name in columns.COLUMNS if header.count(name) > 1]
    if twice:
        raise RecordingError(f"{path}, line 1: column {twice[0]} stands there twice")
