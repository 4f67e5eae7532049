"""How a kernel is compiled with any other numba: by its public options, in its own cache.

Numba's cache compares a function's own file alone, so the stamp of all that is imported is part of
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
    """Compile a function that Python calls."""
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
    """Leave it numba's own cache."""


def take_shortcuts() -> None:
    """Leave numba as it comes."""
