"""The processor's prefetch as an intrinsic in LLVM's terms, a private part of numba."""

from collections.abc import Callable
from typing import Any, Final, cast

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

LINE: Final = 64  # bytes of a cache line

_WRITTEN, _KEPT, _DATA = 1, 3, 1  # for writing; high locality; data cache
_NUMBER = ir.IntType(32)


@cast("Callable[[Any], Callable[[Any, int], None]]", intrinsic)
def fetch(_typing: Any, arrays: Any, _row: Any) -> Any:  # noqa: ANN401 - numba's own
    """Fetch one row of an array, or of each of a tuple of arrays, that are C-contiguous.

    A kernel calls it with two arguments: array or tuple, and the number of the row.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ANN401
        kind, value = signature.args[0], arguments[0]
        whole = isinstance(kind, types.BaseTuple)  # type: ignore[attr-defined]
        values = cgutils.unpack_tuple(builder, value) if whole else [value]
        for each, of in zip(values, kind.types if whole else [kind], strict=True):
            _fetch_row(builder, context.make_array(of)(context, builder, value=each), arguments[1])
        return context.get_dummy_value()

    return types.void(arrays, types.intp), generate


def _fetch_row(builder: Any, array: Any, row: Any) -> None:  # noqa: ANN401
    size = cgutils.unpack_tuple(builder, array.strides)[0]
    begin = builder.gep(builder.bitcast(array.data, cgutils.voidptr_t), [builder.mul(size, row)])
    call = builder.module.declare_intrinsic(
        "llvm.prefetch",
        [begin.type],
        ir.FunctionType(ir.VoidType(), [begin.type, _NUMBER, _NUMBER, _NUMBER]),
    )
    how = [_NUMBER(_WRITTEN), _NUMBER(_KEPT), _NUMBER(_DATA)]
    with cgutils.for_range_slice(builder, size.type(0), size, size.type(LINE)) as (at, _):
        builder.call(call, [builder.gep(begin, [at]), *how])
