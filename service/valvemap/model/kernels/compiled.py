"""How kernels are compiled: IEEE arithmetic in the written order, cached, the lock released.

Numba's cache notices a changed function by its own file alone, not by those of the functions that
it calls. Here the name under which a kernel is cached holds a hash of all files whose kernels are
compiled here, so that none is ever run with a callee of yesterday.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from numba import njit, types

from valvemap.model.kernels.numba_libraries import OfInnerFunctions, OfKernels
from valvemap.model.kernels.numba_seams import spare

F = TypeVar("F", bound=Callable[..., object])

Index = np.uint64  # place in an array: a signed one may count from the end, and no loop of such
# becomes a vector

_CALLED: Final[dict[str, Any]] = {
    "nogil": True,
    "no_cfunc_wrapper": True,
    "pipeline_class": OfKernels,
}
_LINKED: Final[dict[str, Any]] = {
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "pipeline_class": OfInnerFunctions,
}
_ROOMS = Path(__file__).parents[2].glob("*/kernels/*.py")
_SOURCES = [path.read_bytes() for path in sorted(_ROOMS)]
_STAMP = hashlib.sha256(b"".join(s for s in _SOURCES if b"kernels.compiled" in s)).hexdigest()[:12]


def kernel(function: F) -> F:
    """Compile a function that Python calls."""
    return _compile(function, **_CALLED, _nrt=True)


def lean_kernel(function: F) -> F:
    """`kernel`, for what makes no array: references to those that it is handed are not counted.

    Each call that hands on a tuple of thirty arrays counts sixty times, which costs a microsecond.
    """
    return _compile(function, **_CALLED, _nrt=False)


def inner(function: F) -> F:
    """Compile a function that only kernels call: no wrappers, and no reference is counted.

    It makes no array and hands none back: see `maker`. Private seam of numba: the option ``_nrt``.
    """
    return _compile(function, **_LINKED, _nrt=False)


def maker(function: F) -> F:
    """`inner` for what makes arrays or hands them back."""
    return _compile(function, **_LINKED, _nrt=True)


def inlined(function: F) -> F:
    """`inner`, compiled into every kernel that calls it: what is constant there is constant here.

    Only for what few kernels call: each gets a copy.
    """
    return _compile(function, **_LINKED, forceinline=True, _nrt=False)


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


def _compile(function: F, **options: Any) -> F:  # noqa: ANN401 - numba's options
    function.__qualname__ = f"{function.__name__}_{_STAMP}"
    compiled: F = njit(cache=True, error_model="numpy", **options)(function)
    _once_for_all_numbers(compiled)
    return compiled


def _once_for_all_numbers(compiled: Any) -> None:  # noqa: ANN401 - numba's dispatcher
    """Have it compiled once, not once for each constant that a kernel calls it with.

    Constants still reach what is inlined. Private seam of numba: ``get_call_template``.
    """
    find = compiled.get_call_template
    plain: Callable[[Any], Any] = types.unliteral  # type: ignore[attr-defined]

    def find_for_any_number(args: Any, kws: Any) -> Any:  # noqa: ANN401
        return find(tuple(map(plain, args)), {name: plain(kind) for name, kind in kws.items()})

    compiled.get_call_template = find_for_any_number


spare()


@kernel
def _end_of_warm_up() -> None:
    """Compiled last of all."""
