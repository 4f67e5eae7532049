"""Files that are written aside and renamed, so that a kill leaves none half."""

import os
import secrets
from pathlib import Path


def write_owner_only(file: Path, content: bytes) -> None:
    """Write a file that only its owner can read (POSIX mode 0600), whole or not at all."""
    _write(file, content, 0o600)


def write_readable(file: Path, content: bytes) -> None:
    """Write a file that others may read, as the umask allows, whole or not at all."""
    _write(file, content, 0o666)


def _write(file: Path, content: bytes, mode: int) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    draft = file.with_name(f".{file.name}.{secrets.token_hex(4)}")
    descriptor = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    try:
        with os.fdopen(descriptor, "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        draft.replace(file)
    except OSError:
        draft.unlink(missing_ok=True)
        raise
