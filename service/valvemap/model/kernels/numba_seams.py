"""Faster compilation by patches of private parts of numba and llvmlite.

The compiled code is the same. Together they reduce a first start by a seventh and every later
one by a tenth (`python -m benchmarks.start_up first`). They change numba for the whole process;
importing this module changes nothing, and only a command applies them (`valvemap.numba_version`).
"""

import importlib
from collections.abc import Hashable
from typing import Any, Final

from llvmlite.binding import ffi
from numba.core.targetconfig import ConfigStack, TargetConfig
from numba.core.types import Boolean, Number, functions
from numba.np import linalg

_find_call_type: Final = functions.BaseFunction.get_call_type
_found: Final[dict[Hashable, Any]] = {}  # bounded by the number types and operators of numba


def spare() -> None:
    """Patch numba to skip work that no kernel needs, for the rest of this process."""
    _load_numba_without_scipy()
    _note_no_calls_of_llvm()
    _compare_flags_by_what_differs()
    _remember_types_of_operators()


def _load_numba_without_scipy() -> None:
    """Load numba's array functions now, without the search for BLAS at their beginning.

    The search imports scipy.linalg, a tenth of the start-up time, which no kernel here needs; a
    kernel that does imports it later. Patches ``numba.np.arraymath._check_blas``.
    """
    look_for_blas, linalg.ensure_blas = linalg.ensure_blas, _nothing
    try:
        importlib.import_module("numba.np.arraymath")
    finally:
        linalg.ensure_blas = look_for_blas


def _note_no_calls_of_llvm() -> None:
    """Disable the event that numba emits at each call of LLVM, 15,000 of them in a start.

    Patches llvmlite's list of callbacks around its lock.
    """
    ffi.lib._lock._cblist.clear()  # noqa: SLF001


def _compare_flags_by_what_differs() -> None:
    """Compare two sets of flags by their non-default values only.

    All flags have equal hashes, so that every look-up compares two sets; numba compares each of
    their thirty options, 400,000 times in a first start.
    """
    TargetConfig.__eq__ = _are_equal_flags
    TargetConfig.__hash__ = _hash_of_flags


def _are_equal_flags(one: Any, other: object) -> bool:  # noqa: ANN401 - numba has no types
    return one is other or (type(one) is type(other) and _chosen(one) == _chosen(other))


def _hash_of_flags(flags: Any) -> int:  # noqa: ANN401
    return hash(type(flags))


def _chosen(flags: Any) -> dict[str, Any]:  # noqa: ANN401
    options = flags.options
    return {name: x for name, x in flags._values.items() if x != options[name].default}  # noqa: SLF001


def _remember_types_of_operators() -> None:
    """Cache the type of ``a + b`` of two numbers, instead of resolving it at each use.

    Numba tries all overloads of ``+`` each time, and formats the reason why each one but the match
    is rejected.
    """
    functions.BaseFunction.get_call_type = _call_type  # type: ignore[method-assign]


def _call_type(self: Any, context: Any, args: Any, kws: Any) -> Any:  # noqa: ANN401
    if kws or not all(isinstance(one, Number | Boolean) for one in args):
        return _find_call_type(self, context, args, kws)
    key = (id(self), context, args, ConfigStack.top_or_none())
    if key not in _found:
        _found[key] = self, _find_call_type(self, context, args, kws)  # keeps the id of self
    return _found[key][1]


def _nothing() -> None:
    pass
