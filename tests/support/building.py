"""Programs of foreign stacks are built once, whichever process of pytest needs them first."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def building(folder: Path) -> Iterator[None]:
    """Hold a folder of built programs; other processes wait, and then find what is ready."""
    import fcntl  # on no system but those that have these programs

    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "building").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
