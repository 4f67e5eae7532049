"""Compilation of a kernel with a numba whose private parts are tested."""

from collections.abc import Callable
from typing import Any, Final, TypeVar

from numba import njit, types

from valvemap.model.kernels import cache
from valvemap.model.kernels.cache import TREES
from valvemap.model.kernels.interpreted import interpretable
from valvemap.model.kernels.numba_libraries import OfInnerFunctions, OfKernels
from valvemap.model.kernels.numba_seams import spare as take_shortcuts
from valvemap.numba_version import are_shortcuts_asked_for

__all__ = ["TREES", "called", "keep", "linked", "spliced", "take_shortcuts"]

F = TypeVar("F", bound=Callable[..., object])

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


def called(function: F, *, counts: bool) -> F:
    """Compile a function that is called from Python; ``counts``: with reference counting."""
    return spliced(function, **_CALLED, _nrt=counts)


def linked(function: F, *, counts: bool, **options: Any) -> F:  # noqa: ANN401 - numba's options
    """Compile a function that only kernels call."""
    return spliced(function, **_LINKED, _nrt=counts, **options)


def spliced(function: F, **options: Any) -> F:  # noqa: ANN401
    """Compile a function with these options of numba alone."""
    compiled: F = njit(error_model="numpy", **options)(function)
    keep(compiled)
    _once_for_all_numbers(compiled)
    return compiled


def keep(dispatcher: Any) -> None:  # noqa: ANN401 - numba's dispatcher
    """Cache a dispatcher's code; until it has code, `interpreted` may run it as plain Python."""
    cache.keep(dispatcher)
    interpretable(dispatcher)


def _once_for_all_numbers(compiled: Any) -> None:  # noqa: ANN401 - numba's dispatcher
    """Compile it once, not once for each constant argument.

    Constants still reach inlined functions. Private part of numba: ``get_call_template``.
    """
    find = compiled.get_call_template
    plain: Callable[[Any], Any] = types.unliteral  # type: ignore[attr-defined]

    def find_for_any_number(args: Any, kws: Any) -> Any:  # noqa: ANN401
        return find(tuple(map(plain, args)), {name: plain(kind) for name, kind in kws.items()})

    compiled.get_call_template = find_for_any_number


if are_shortcuts_asked_for():
    take_shortcuts()
