"""How kernels are compiled: IEEE arithmetic in the written order, cached, the lock released.

A kernel is cached under the stamp of its module and of all that the module imports, so that none
is ever run with a callee of yesterday, and another comment compiles nothing. With a version of
numba that is not tested (`valvemap.numba_version`), only its public options and its own cache are
used.
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

Index = np.uint64  # place in an array: a signed one may count from the end, and no loop of such
# becomes a vector

_PACKAGE: Final = Path(__file__).parents[2]
_ROOMS: Final = "*/kernels/*.py"


def kernel(function: F) -> F:
    """Compile a function that Python calls."""
    return numba.called(function, counts=True)


def lean_kernel(function: F) -> F:
    """`kernel`, for what makes no array: references to those that it is handed are not counted.

    Each call that hands on a tuple of thirty arrays counts sixty times, which costs a microsecond.
    Private part of numba: the option ``_nrt``.
    """
    return numba.called(function, counts=False)


def inner(function: F) -> F:
    """Compile a function that only kernels call: no wrappers, and no reference is counted.

    It makes no array and hands none back: see `maker`.
    """
    return numba.linked(function, counts=False)


def maker(function: F) -> F:
    """`inner` for what makes arrays or hands them back."""
    return numba.linked(function, counts=True)


def inlined(function: F) -> F:
    """`inner`, compiled into every kernel that calls it: what is constant there is constant here.

    Only for what few kernels call: each gets a copy.
    """
    return numba.linked(function, counts=False, forceinline=True)


def spliced(function: F) -> F:
    """Write a function into the one kernel that calls it, before anything is compiled.

    A callee that is compiled by itself is compiled once more with each of its callers. For what
    has one caller; what has more is written into each.
    """
    return numba.spliced(function, inline="always")


def take_shortcuts() -> None:
    """Change numba for the rest of this process, in which no command asked before the import."""
    numba.take_shortcuts()


def kept(dispatcher: F) -> F:
    """Cache what numba's own decorator makes as kernels are, and as it was decorated."""
    numba.keep(dispatcher)
    return dispatcher


def keep_kernels(module: ModuleType) -> None:
    """`kept` for every function of a module that numba compiles."""
    for value in vars(module).values():
        if is_jitted(value):
            kept(value)


def was_warmed_up() -> bool:
    """Whether a warm-up came to its end before, here or for the wheel, with kernels as they are."""
    came = ahead.folder()
    notes = [_note(), *([came / ahead.COMPLETE] if came is not None else [])]
    return any(_read(note) == _stamp_of_all() for note in notes)


def note_warm_up() -> None:
    """Make `was_warmed_up` true from now on; where nothing can be kept it stays false."""
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
    """The file that says so, one for each kind of machine that shares the cache."""
    into = ahead.into()
    if into is not None:
        return into / ahead.COMPLETE
    kind = config.CPU_NAME or binding.get_host_cpu_name(), config.CPU_FEATURES
    machine = hashlib.sha256(repr(kind).encode()).hexdigest()[:12]
    folder: Any = _nothing
    return Path(folder.stats.cache_path) / f"warmed-up-{machine}"


def _stamp_of_all() -> str:
    """A stamp of every kernel, of numba and of Python."""
    files = sorted(_PACKAGE.glob(_ROOMS))
    contents = [numba.TREES.of(file, _module_of(file)).content for file in files]
    whole = version("numba"), sys.implementation.cache_tag, contents
    return hashlib.sha256(repr(whole).encode()).hexdigest()


def _module_of(file: Path) -> str:
    return ".".join(file.relative_to(_PACKAGE.parent).with_suffix("").parts)


@kernel
def _nothing() -> None:
    """Knows where kernels are cached."""
