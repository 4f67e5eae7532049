"""Compilation of kernels: IEEE arithmetic in the written order, cached, without the GIL.

A kernel is cached under the stamp of its module and of all modules that this imports. A change of
a callee therefore recompiles it, and a change of a comment does not. With an untested version of
numba (`valvemap.numba_version`), only its public options and its own cache are used.
"""

import hashlib
import sys
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any, Final, TypeVar

import numpy as np
from llvmlite import binding
from numba.core import config
from numba.extending import is_jitted

from valvemap.model.kernels import ahead
from valvemap.numba_version import is_tested

if is_tested():
    from valvemap.model.kernels import tested_numba as numba
else:
    from valvemap.model.kernels import plain_numba as numba  # type: ignore[no-redef]

F = TypeVar("F", bound=Callable[..., object])

Index = np.uint64  # array index; a signed one may be negative, which prevents the vectorization of
# loops

_PACKAGE: Final = Path(__file__).parents[2]
_ROOMS: Final = "*/kernels/*.py"


def kernel(function: F) -> F:
    """Compile a function that is called from Python."""
    return numba.called(function, counts=True)


def lean_kernel(function: F) -> F:
    """`kernel` for functions that create no arrays: references to their arguments are not counted.

    A call that passes a tuple of thirty arrays would otherwise count sixty times, which costs a
    microsecond. Private part of numba: the option ``_nrt``.
    """
    return numba.called(function, counts=False)


def inner(function: F) -> F:
    """Compile a function that only kernels call: no wrappers, no reference counting.

    It must not create or return arrays: see `maker`.
    """
    return numba.linked(function, counts=False)


def maker(function: F) -> F:
    """`inner` for functions that create or return arrays."""
    return numba.linked(function, counts=True)


def inlined(function: F) -> F:
    """`inner`, inlined into every kernel that calls it, with its constants.

    Only for functions with few callers: each gets a copy.
    """
    return numba.linked(function, counts=False, forceinline=True)


def spliced(function: F) -> F:
    """Splice a function into the only kernel that calls it, before compilation.

    A separately compiled callee is compiled again with each of its callers. With several callers,
    it is copied into each.
    """
    return numba.spliced(function, inline="always")


def take_shortcuts() -> None:
    """Apply the patches of numba for the rest of this process, unless done before the import."""
    numba.take_shortcuts()


def kept(dispatcher: F) -> F:
    """Cache a function of numba's own decorator like a kernel, with its options."""
    numba.keep(dispatcher)
    return dispatcher


def keep_kernels(module: ModuleType) -> None:
    """Apply `kept` to every compiled function of a module."""
    for value in vars(module).values():
        if is_jitted(value):
            kept(value)


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
    """Return a stamp of all kernels, numba and Python."""
    files = sorted(_PACKAGE.glob(_ROOMS))
    contents = [numba.TREES.of(file, _module_of(file)).content for file in files]
    whole = version("numba"), sys.implementation.cache_tag, contents
    return hashlib.sha256(repr(whole).encode()).hexdigest()


def _module_of(file: Path) -> str:
    return ".".join(file.relative_to(_PACKAGE.parent).with_suffix("").parts)


@kernel
def _nothing() -> None:
    """Do nothing; the location of its cache is that of all kernels."""
