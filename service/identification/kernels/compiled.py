"""How kernels are compiled: IEEE arithmetic in the written order, cached, the lock released.

Numba's cache notices a changed function by its own file alone, not by those of the functions that
it calls. Here the name under which a kernel is cached holds a hash of all files whose kernels are
compiled here, so that none is ever run with a callee of yesterday.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from numba import njit

F = TypeVar("F", bound=Callable[..., object])

_SOURCES = [path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py"))]
_STAMP = hashlib.sha256(b"".join(s for s in _SOURCES if b"kernels.compiled" in s)).hexdigest()[:12]


def kernel(function: F) -> F:
    """Compile a function that Python calls."""
    return _compile(function, nogil=True, no_cfunc_wrapper=True)


def inner(function: F) -> F:
    """Compile a function that only kernels call: no wrappers, a third less to compile."""
    return _compile(function, no_cpython_wrapper=True, no_cfunc_wrapper=True)


def inlined(function: F) -> F:
    """Compile a function into every kernel that calls it: what is constant there is constant here.

    Only for what few kernels call: each gets a copy.
    """
    return _compile(function, no_cpython_wrapper=True, no_cfunc_wrapper=True, forceinline=True)


def _compile(function: F, **options: bool) -> F:
    function.__qualname__ = f"{function.__name__}_{_STAMP}"
    compiled: F = njit(cache=True, error_model="numpy", **options)(function)  # type: ignore[call-overload]
    return compiled
