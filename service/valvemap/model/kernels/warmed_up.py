"""Whether all kernels are compiled: a note beside their cache, here or in the wheel."""

import hashlib
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from llvmlite import binding
from numba.core import config

from valvemap.model.kernels import ahead
from valvemap.model.kernels.compiled import TREES, kernel
from valvemap.model.kernels.stamps import stamp_of_modules

_PACKAGE: Final = Path(__file__).parents[2]
_ROOMS: Final = "*/kernels/*.py"


def was_warmed_up() -> bool:
    """Whether a warm-up with these kernels has been completed, here or for the wheel."""
    came = ahead.folder()
    notes = [_note(), *([came / ahead.COMPLETE] if came is not None else [])]
    return any(_read(note) == _stamp_of_all() for note in notes)


def note_warm_up() -> None:
    """Record a completed warm-up; without a cache, nothing is recorded."""
    try:
        _note().write_text(_stamp_of_all(), encoding="utf-8")
    except OSError:
        return


def _read(note: Path) -> str:
    try:
        return note.read_text(encoding="utf-8")
    except OSError:
        return ""


def _note() -> Path:
    """Return the record's file, one for each kind of machine that shares the cache."""
    into = ahead.into()
    if into is not None:
        return into / ahead.COMPLETE
    kind = config.CPU_NAME or binding.get_host_cpu_name(), config.CPU_FEATURES
    machine = hashlib.sha256(repr(kind).encode()).hexdigest()[:12]
    folder: Any = _nothing
    return Path(folder.stats.cache_path) / f"warmed-up-{machine}"


def _stamp_of_all() -> str:
    """Return a stamp of all kernels and what they import, numba and Python."""
    files = {_module_of(file): file for file in _PACKAGE.glob(_ROOMS)}
    whole = version("numba"), sys.implementation.cache_tag, stamp_of_modules(files, TREES)
    return hashlib.sha256(repr(whole).encode()).hexdigest()


def _module_of(file: Path) -> str:
    return ".".join(file.relative_to(_PACKAGE.parent).with_suffix("").parts)


@kernel
def _nothing() -> None:
    """Do nothing; the location of its cache is that of all kernels."""
