"""How the kernels of alignment are compiled: they make no arrays, so they count no references.

Numba counts who holds an array: each look into a row of one adds one and takes it away again,
both atomic steps, and so does each array of a tuple that a function is given. Here that took ten
times as long as the work itself. All arrays are the caller's, who keeps them. Private seam of
numba, as in its own ``numba.misc.mergesort``: the option ``_nrt``. What would make an array is
refused.
"""

from collections.abc import Callable
from typing import TypeVar

import valvemap.model.kernels.compiled as counted

F = TypeVar("F", bound=Callable[..., object])


def kernel(function: F) -> F:
    """Compile a function that Python calls."""
    return _uncounted(counted.kernel(function))


def inner(function: F) -> F:
    """Compile a function that kernels call, and seldom: to hand over all arrays takes 30 ns."""
    return _uncounted(counted.inner(function))


def inlined(function: F) -> F:
    """Compile a function into the few places that call it for every change or sample."""
    return _uncounted(counted.inlined(function))


def _uncounted(function: F) -> F:
    function.targetoptions["_nrt"] = False  # type: ignore[attr-defined]
    return function
