"""How the kernels of alignment are compiled: they make no arrays, so they count no references.

Numba counts who holds an array: each look into a row of one adds one and takes it away again,
both atomic steps, and so does each array of a tuple that a function is given. Here that took ten
times as long as the work itself. All arrays are the caller's, who keeps them. What would make an
array is refused.
"""

from valvemap.model.kernels.compiled import inlined, inner
from valvemap.model.kernels.compiled import lean_kernel as kernel

__all__ = ["inlined", "inner", "kernel"]
