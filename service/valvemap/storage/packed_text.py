"""Text in files that may be compressed: packing, encoding, and damage as a `RecordingError`."""

import csv
import gzip
import io
import lzma
import re
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, BinaryIO, Final, cast

from valvemap.errors import NoRecording, RecordingError

PACKINGS: Final = (".csv", ".csv.gz", ".csv.xz")
DAMAGE: Final = (EOFError, zlib.error, lzma.LZMAError, gzip.BadGzipFile, csv.Error)
"""What a damaged file raises."""
HEADER_LIMIT: Final = 65_536  # characters of a line of headings
_PEEK: Final = 65_536  # bytes
_NO_TEXT: Final = re.compile(rb"[\x00-\x08\x0e-\x1f\x81\x8d\x8f\x90\x9d]")
_MAGICS: Final = {b"\x1f\x8b": ".csv.gz", b"\xfd7zXZ\x00": ".csv.xz"}
_MAGIC: Final = 6  # bytes of the longest
_WIDE: Final = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}  # by the byte order mark


def opened_text(path: Path, raw: io.BufferedReader, packing: str) -> io.TextIOWrapper:
    """Return the text of an open file, packed as its name or its first bytes say.

    Raises
    ------
    NoRecording
        if it is a workbook or an archive.
    RecordingError
        if it is damaged.
    """
    packing = _packing(path, raw.peek(_MAGIC)[:_MAGIC], packing)
    return _decoded(path, _unpacked(raw, packing))


def packed(packing: str, text: bytes) -> bytes:
    """Compress text for appending, as a separate gzip member or xz stream."""
    match packing:
        case ".csv.gz":
            return gzip.compress(text, compresslevel=6, mtime=0)
        case ".csv.xz":
            return lzma.compress(text, preset=3)
        case _:
            return text


@contextmanager
def text_of(path: Path, packing: str) -> Iterator[Iterator[str]]:
    """Yield the lines of a file; damage is a `RecordingError`."""
    number = 0
    with Faults(path, lambda: number), path.open("rb") as raw:
        yield iter(_decoded(path, _unpacked(raw, packing)))


class Faults:
    """Converts exceptions of reading text to a RecordingError."""

    def __init__(self, path: Path, line: Callable[[], int]) -> None:
        self._path = path
        self._line = line

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, UnicodeDecodeError):
            raise RecordingError(
                f"{self._path} is not a recording: no UTF-8 text behind line {self._line()}; save "
                "it as CSV UTF-8"
            ) from None
        if isinstance(error, DAMAGE):
            raise RecordingError(
                f"{self._path} is cut off or damaged behind line {self._line()}: {error}"
            ) from None
        if isinstance(error, FileNotFoundError):
            raise NoRecording(f"{self._path} does not exist") from None
        if isinstance(error, OSError):
            raise RecordingError(
                f"{self._path} cannot be read: {error.strerror or error}"
            ) from error


def _decoded(path: Path, unpacked: IO[bytes]) -> io.TextIOWrapper:
    whole = io.BufferedReader(cast("io.RawIOBase", unpacked), _PEEK)
    with Faults(path, lambda: 0):
        encoding = _encoding(whole.peek(_PEEK))
    return io.TextIOWrapper(whole, encoding=encoding, newline="")


def _unpacked(raw: BinaryIO, packing: str) -> IO[bytes]:
    match packing:
        case ".csv.gz":
            return cast("IO[bytes]", gzip.GzipFile(fileobj=raw))
        case ".csv.xz":
            return lzma.LZMAFile(raw)
        case _:
            return raw


def _packing(path: Path, beginning: bytes, named: str) -> str:
    """Return how a file is packed: as its name says, else by its first bytes."""
    if beginning.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):
        raise NoRecording(f"{path} is a workbook or an archive: save the sheet as CSV")
    if named != ".csv":
        return named
    return next((form for magic, form in _MAGICS.items() if beginning.startswith(magic)), named)


def _encoding(beginning: bytes) -> str:
    """Return the encoding, detected from the first bytes."""
    if beginning[:2] in _WIDE:
        return _WIDE[beginning[:2]]
    if beginning[1:2] == b"\0" and beginning[3:4] == b"\0":
        return "utf-16-le"
    if beginning[:1] == b"\0" and beginning[2:3] == b"\0":
        return "utf-16-be"
    try:
        beginning[:HEADER_LIMIT].decode("utf-8")
    except UnicodeDecodeError as error:
        cut_off = error.start >= len(beginning) - 4
        if not cut_off and not _NO_TEXT.search(beginning):
            return "cp1252"  # e.g. the ° of °C from a spreadsheet
    return "utf-8-sig"
