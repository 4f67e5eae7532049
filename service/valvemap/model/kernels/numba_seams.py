"""What numba does at length and can be spared, by private seams of numba and llvmlite.

Nothing here changes what is compiled. Together they take a seventh off a first start and a tenth
off every later one (`python -m benchmarks.start_up first`). They change numba for the whole
process, so only a command asks for them (`valvemap.numba_version`); importing this changes nothing.
"""

import importlib
from collections.abc import Hashable
from typing import Any, Final

from llvmlite.binding import ffi
from numba.core.targetconfig import ConfigStack, TargetConfig
from numba.core.types import Boolean, Number, functions
from numba.np import linalg

_find_call_type: Final = functions.BaseFunction.get_call_type
_found: Final[dict[Hashable, Any]] = {}  # bounded by the kinds of numbers and numba's operators


def spare() -> None:
    """Make numba leave out what no kernel needs, in this process and from now on."""
    _load_numba_without_scipy()
    _note_no_calls_of_llvm()
    _compare_flags_by_what_differs()
    _remember_types_of_operators()


def _load_numba_without_scipy() -> None:
    """Have numba load its array functions now, without the look for BLAS that they begin with.

    It imports scipy.linalg, a tenth of what a start of the service takes, and no kernel here uses
    it; one that does imports it then. Seam: ``numba.np.arraymath._check_blas``.
    """
    look_for_blas, linalg.ensure_blas = linalg.ensure_blas, _nothing
    try:
        importlib.import_module("numba.np.arraymath")
    finally:
        linalg.ensure_blas = look_for_blas


def _note_no_calls_of_llvm() -> None:
    """Have numba make no events of each call of LLVM: a start makes 15,000, and nobody listens.

    Seam: llvmlite's list of what is called with its lock.
    """
    ffi.lib._lock._cblist.clear()  # noqa: SLF001


def _compare_flags_by_what_differs() -> None:
    """Have two sets of flags compared by those that are not as by default.

    All flags hash alike, so every look for an implementation compares two; numba compares each of
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
    """Have the type of ``a + b`` of two numbers looked up once, not at each place in a kernel.

    Numba tries every meaning of ``+`` anew, and writes down why each but one does not fit.
    """
    functions.BaseFunction.get_call_type = _call_type  # type: ignore[method-assign]


def _call_type(self: Any, context: Any, args: Any, kws: Any) -> Any:  # noqa: ANN401
    if kws or not all(isinstance(one, Number | Boolean) for one in args):
        return _find_call_type(self, context, args, kws)
    key = (id(self), context, args, ConfigStack.top_or_none())
    if key not in _found:
        _found[key] = self, _find_call_type(self, context, args, kws)  # self is kept: so is its id
    return _found[key][1]


def _nothing() -> None:
    pass
