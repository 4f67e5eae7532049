"""Compilation of kernels: IEEE arithmetic in the written order, cached, without the GIL.

A kernel is cached under the stamp of its module and of all modules that this imports. A change of
a callee therefore recompiles it, and a change of a comment does not. With an untested version of
numba (`valvemap.numba_version`), only its public options and its own cache are used; in a process
that does without numba, kernels run as plain Python.
"""

from collections.abc import Callable
from types import ModuleType
from typing import Final, TypeVar

import numpy as np

from valvemap.numba_version import is_left_out, is_tested

if is_left_out():
    from valvemap.model.kernels import without_numba as numba
elif is_tested():
    from valvemap.model.kernels import tested_numba as numba  # type: ignore[no-redef]
else:
    from valvemap.model.kernels import plain_numba as numba  # type: ignore[no-redef]

TREES: Final = numba.TREES
"""Syntax trees of the modules that were asked for."""

F = TypeVar("F", bound=Callable[..., object])

Index = np.uint64  # array index; a signed one may be negative, which prevents the vectorization of
# loops


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
        if hasattr(value, "py_func"):
            kept(value)
