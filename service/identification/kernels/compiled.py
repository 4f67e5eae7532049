"""How kernels are compiled: IEEE arithmetic in the written order, cached, the lock released.

Numba's cache notices a changed function by its own file alone, not by those of the functions that
it calls. Here the name under which a kernel is cached holds a hash of all files whose kernels are
compiled here, so that none is ever run with a callee of yesterday.
"""

import hashlib
import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from llvmlite.binding import ffi
from numba import njit, types
from numba.np import linalg

F = TypeVar("F", bound=Callable[..., object])

Index = np.uint64  # place in an array: a signed one may count from the end, and no loop of such
# becomes a vector

_ROOMS = Path(__file__).parents[2].glob("*/kernels/*.py")
_SOURCES = [path.read_bytes() for path in sorted(_ROOMS)]
_STAMP = hashlib.sha256(b"".join(s for s in _SOURCES if b"kernels.compiled" in s)).hexdigest()[:12]


def kernel(function: F) -> F:
    """Compile a function that Python calls."""
    return _compile(function, nogil=True, no_cfunc_wrapper=True, _nrt=True)


def lean_kernel(function: F) -> F:
    """`kernel`, for what makes no array: references to those that it is handed are not counted.

    Each call that hands on a tuple of thirty arrays counts sixty times, which costs a microsecond.
    """
    return _compile(function, nogil=True, no_cfunc_wrapper=True, _nrt=False)


def inner(function: F) -> F:
    """Compile a function that only kernels call: no wrappers, and no reference is counted.

    It makes no array and hands none back: see `maker`. Private seam of numba: the option ``_nrt``.
    """
    return _compile(function, no_cpython_wrapper=True, no_cfunc_wrapper=True, _nrt=False)


def maker(function: F) -> F:
    """`inner` for what makes arrays or hands them back."""
    return _compile(function, no_cpython_wrapper=True, no_cfunc_wrapper=True, _nrt=True)


def inlined(function: F) -> F:
    """`inner`, compiled into every kernel that calls it: what is constant there is constant here.

    Only for what few kernels call: each gets a copy.
    """
    return _compile(
        function, no_cpython_wrapper=True, no_cfunc_wrapper=True, forceinline=True, _nrt=False
    )


def spliced(function: F) -> F:
    """Write a function into the one kernel that calls it, before anything is compiled.

    A callee that is compiled by itself is compiled once more with each of its callers. For what
    has one caller; what has more is written into each.
    """
    return _compile(function, inline="always")


def was_warmed_up() -> bool:
    """Whether a warm-up came to its end here before, with the kernels as they are.

    Private seam of numba: the dispatcher's ``_cache``, asked without compiling.
    """
    found = _end_of_warm_up._cache.load_overload((), _end_of_warm_up.targetctx)  # type: ignore[attr-defined]  # noqa: SLF001
    return found is not None


def note_warm_up() -> None:
    """Have `was_warmed_up` say so from now on."""
    _end_of_warm_up()


def _load_numba_without_scipy() -> None:
    """Have numba load its array functions now, without the look for BLAS that they begin with.

    It imports scipy.linalg, a tenth of what a start of the service takes, and no kernel here uses
    it; one that does imports it then. Private seam of numba: ``numba.np.arraymath._check_blas``.
    """
    look_for_blas, linalg.ensure_blas = linalg.ensure_blas, _nothing
    try:
        importlib.import_module("numba.np.arraymath")
    finally:
        linalg.ensure_blas = look_for_blas


def _note_no_calls_of_llvm() -> None:
    """Have numba make no events of each call of LLVM: a start makes 15,000, and nobody listens.

    Private seam of llvmlite: the list of what is called with its lock.
    """
    ffi.lib._lock._cblist.clear()  # noqa: SLF001


def _nothing() -> None:
    pass


def _compile(function: F, **options: bool | str) -> F:
    function.__qualname__ = f"{function.__name__}_{_STAMP}"
    compiled: F = njit(cache=True, error_model="numpy", **options)(function)  # type: ignore[call-overload]
    _once_for_all_numbers(compiled)
    return compiled


def _once_for_all_numbers(compiled: Any) -> None:  # noqa: ANN401 - numba's dispatcher
    """Have it compiled once, not once for each constant that a kernel calls it with.

    Constants still reach what is inlined. Private seam of numba: ``get_call_template``.
    """
    find = compiled.get_call_template
    plain: Callable[[Any], Any] = types.unliteral

    def find_for_any_number(args: Any, kws: Any) -> Any:  # noqa: ANN401
        return find(tuple(map(plain, args)), {name: plain(kind) for name, kind in kws.items()})

    compiled.get_call_template = find_for_any_number


_load_numba_without_scipy()
_note_no_calls_of_llvm()


@kernel
def _end_of_warm_up() -> None:
    """Compiled last of all."""
