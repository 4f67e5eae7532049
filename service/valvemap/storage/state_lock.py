"""Exclusive use of a file by one process, through a lock file beside it."""

import fcntl
import os
from contextlib import suppress
from pathlib import Path

from valvemap.errors import StorageError

_LONGEST = 20  # digits of a process number


class FileLock:
    """Holds ``<file>.lock`` locked until it is closed or the process ends, however it ends.

    The lock is the kernel's (flock), not the existence of the file: a file left by a killed process
    is no lock. It is held beside the file because SQLite's own locks end with any descriptor of it.

    Parameters
    ----------
    file
        The file to be used by this process alone; its folder exists.

    Raises
    ------
    StorageError
        if another process holds it; names that process.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self._path = file.with_name(f"{file.name}.lock")
        self._descriptor = self._locked()

    def check(self) -> None:
        """Lock the file again if it was removed or replaced; as the constructor."""
        if not is_at(self._path, os.fstat(self._descriptor)):
            new = self._locked()
            os.close(self._descriptor)
            self._descriptor = new

    def close(self) -> None:
        """Release the lock; safe to call twice. The file stays: removing it would race."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def _locked(self) -> int:
        descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.ftruncate(descriptor, 0)
            os.write(descriptor, f"{os.getpid()}\n".encode())
        except BlockingIOError:
            said = os.read(descriptor, _LONGEST).decode("ascii", "replace").strip()
            os.close(descriptor)
            by = f"process {said}" if said.isdigit() else "another process"
            raise StorageError(
                f"{self._file} is in use by {by}: each service needs a state.file of its own"
            ) from None
        except BaseException:
            os.close(descriptor)
            raise
        return descriptor


def is_at(path: Path, identity: os.stat_result) -> bool:
    """Whether the file at ``path`` is the one with this device and number."""
    with suppress(OSError):
        found = path.stat()
        return (found.st_dev, found.st_ino) == (identity.st_dev, identity.st_ino)
    return False
