"""Compilation of the alignment's kernels: they allocate no arrays and count no references.

Numba counts references to arrays: each view of a row increments and decrements a count atomically,
and so does each array of a tuple argument. In these kernels that took ten times as long as the work
itself. All arrays are owned by the caller, which keeps them alive. Code that would allocate an
array is rejected.
"""

from valvemap.model.kernels.compiled import inlined, inner
from valvemap.model.kernels.compiled import lean_kernel as kernel

__all__ = ["inlined", "inner", "kernel"]
