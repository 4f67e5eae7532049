"""Compilation of a kernel with any other numba: with public options and its own cache.

Numba's cache compares a function's own file only, so the stamp of all imported modules is part of
the name under which a kernel is cached.
"""

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar

from numba import njit

from valvemap.model.kernels.stamps import Trees, stamp_of_module

F = TypeVar("F", bound=Callable[..., object])

TREES: Final = Trees()
"""Syntax trees of kernels' modules."""


def called(function: F, *, counts: bool) -> F:  # noqa: ARG001 - numba counts them all
    """Compile a function that is called from Python."""
    return spliced(function, nogil=True)


def linked(function: F, *, counts: bool, **options: Any) -> F:  # noqa: ANN401, ARG001
    """Compile a function that only kernels call."""
    return spliced(function, **options)


def spliced(function: F, **options: Any) -> F:  # noqa: ANN401 - numba's options
    """Compile a function with these options of numba alone."""
    stamp = stamp_of_module(function.__module__, Path(inspect.getfile(function)), TREES)
    function.__qualname__ = f"{function.__name__}_{stamp[:12]}"
    compiled: F = njit(cache=True, error_model="numpy", **options)(function)
    return compiled


def keep(dispatcher: object) -> None:
    """Do nothing: numba's own cache is used."""


def take_shortcuts() -> None:
    """Do nothing: numba is not patched."""
