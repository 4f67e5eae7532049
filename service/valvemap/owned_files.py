"""Files that people own: written aside in the same folder and renamed, so that none is half."""

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from valvemap.errors import StorageError

ASIDE: Final = ".part"  # ends the name of a file that is being written


def write_whole(file: Path, content: str | bytes) -> None:
    """Write a file whole or not at all; texts in UTF-8.

    A kill at any moment leaves the file as it was, or as it is to be, on disk.

    Raises
    ------
    StorageError
        naming the file.
    """
    with written_aside(file) as draft:
        draft.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)


@contextmanager
def written_aside(file: Path) -> Iterator[Path]:
    """Give a name in the same folder to write to; at the end it takes the place of ``file``.

    A device or a pipe, such as ``/dev/stdout``, is written directly.

    Raises
    ------
    StorageError
        naming the file; it is as it was.
    """
    target = Path(os.path.realpath(file))  # a link stays a link
    if target.exists() and not target.is_file():
        with naming(file):
            yield target
        return
    draft = target.with_name(f".{target.name}.{secrets.token_hex(4)}{ASIDE}")
    try:
        with naming(file):
            yield draft
            if target.exists():
                shutil.copymode(target, draft)
            _to_disk(draft)
            draft.replace(target)
            _to_disk(target.parent)
    finally:
        draft.unlink(missing_ok=True)


@contextmanager
def naming(file: Path, failed: str = "") -> Iterator[None]:
    """Raise an OSError as a StorageError that names the file and the action that ``failed``.

    >>> with naming(Path("log.csv")):
    ...     raise OSError(28, "No space left on device")
    Traceback (most recent call last):
    valvemap.errors.StorageError: log.csv: no space left on device
    >>> with naming(Path("log.csv"), "cannot be written"):
    ...     raise OSError(28, "No space left on device")
    Traceback (most recent call last):
    valvemap.errors.StorageError: log.csv cannot be written: No space left on device
    """
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        said = f"{file} {failed}: {reason}" if failed else f"{file}: {reason.lower()}"
        raise StorageError(said) from error


def make_folder(folder: Path) -> None:
    """Make a folder with those above it, if it is missing.

    Raises
    ------
    StorageError
        with the folder's name and the reason.
    """
    with naming(folder):
        folder.mkdir(parents=True, exist_ok=True)


def _to_disk(path: Path) -> None:
    """Wait until the disk has a file, or a folder's names; Windows cannot open a folder."""
    if os.name == "nt" and path.is_dir():
        return
    descriptor = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
