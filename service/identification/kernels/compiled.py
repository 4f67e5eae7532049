"""How kernels are compiled: IEEE arithmetic in the written order, cached, the lock released."""

from numba import njit

# Called from Python.
kernel = njit(cache=True, error_model="numpy", nogil=True, no_cfunc_wrapper=True)  # type: ignore[call-overload]

# Called from kernels alone: without the wrappers a third of the first start's compilation is saved.
inner = njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)  # type: ignore[call-overload]
