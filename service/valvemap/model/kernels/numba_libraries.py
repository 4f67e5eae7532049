"""Numba's libraries, compiled and loaded no further than kernels need.

Numba optimises each function, generates its machine code, and optimises it again in every kernel
that it is linked into. The first two steps serve callers from Python, which an inner function does
not have: without them a first start takes an eighth less. With a cached kernel, numba also loads
the bitcode for linking it into others, which is rarely needed: without it, kernels load in a third
of the time.

Numba's classes are not changed: a kernel names its pipeline when it is compiled, and its cache
calls `load_library`. Private parts of numba: all names of its libraries with an underscore.
"""

import hashlib
import lzma
import pickle
from collections.abc import Iterable
from functools import cache
from typing import Any, Final

from llvmlite import binding
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.untyped_passes import IRProcessing

from valvemap.model.kernels import ahead

_KIND: Final = "object, its names"


class OfKernels(CompilerBase):
    """Numba's pipeline for functions called from Python: their option ``pipeline_class``."""

    def define_pipelines(self) -> list[Any]:
        """Numba's passes, with our code generator."""
        return _pipelines(self.state, _IntoKernel)


class OfInnerFunctions(CompilerBase):
    """Numba's pipeline for functions called by kernels only."""

    def define_pipelines(self) -> list[Any]:
        """Numba's passes, with our code generator."""
        return _pipelines(self.state, _IntoPart)


def load_library(codegen: Any, state: Any) -> JITCodeLibrary:  # noqa: ANN401
    """Load a serialised library."""
    name, kind, data = state
    if kind == _KIND:
        return _Kernel.loaded(codegen, name, data)
    return codegen.unserialize_library(state)


def packed(state: Any, bitcodes: dict[bytes, bytes]) -> Any:  # noqa: ANN401
    """Return a serialised library for a wheel; None for one that only a compiler needs.

    A kernel's bitcode is the larger part of it and is read only to link the kernel into another
    one. It is moved to ``bitcodes``, which are compressed together, and replaced by its hash.
    """
    name, kind, data = state
    if kind == _KIND:
        machine_code, bitcode, names = data
        digest = hashlib.sha256(bitcode).digest()
        bitcodes[digest] = bitcode
        return name, kind, (machine_code, digest, names)
    return None if kind == "bitcode" else state


@cache
def _shipped_bitcodes() -> dict[bytes, bytes]:
    folder = ahead.folder()
    assert folder is not None  # noqa: S101 - a kernel was loaded from it
    found: dict[bytes, bytes] = pickle.loads(  # noqa: S301 - part of the package
        lzma.decompress((folder / ahead.BITCODES).read_bytes())
    )
    return found


class _Kernel(JITCodeLibrary):
    """Serialised with the names that it defines, so that loading need not parse it."""

    _unparsed: bytes | None = None

    def serialize_using_object_code(self) -> tuple[str, str, Any]:
        name, _, (machine_code, bitcode) = super().serialize_using_object_code()
        return name, _KIND, (machine_code, bitcode, sorted(_defined(self._final_module)))

    @classmethod
    def loaded(cls, codegen: Any, name: str, data: Any) -> "_Kernel":  # noqa: ANN401
        library = cls(codegen, name)
        machine_code, library._unparsed, names = data
        library.enable_object_caching()
        library._set_compiled_object(machine_code)
        library._finalize_final_module()
        codegen._engine._defined_symbols.update(names)  # noqa: SLF001
        return library

    def _get_module_for_linking(self) -> Any:  # noqa: ANN401
        if self._unparsed is not None:
            is_hash = len(self._unparsed) == hashlib.sha256().digest_size
            bitcode = _shipped_bitcodes()[self._unparsed] if is_hash else self._unparsed
            self._shared_module, self._unparsed = binding.parse_bitcode(bitcode), None
        return super()._get_module_for_linking()


class _Part(JITCodeLibrary):
    """Unoptimised code for linking."""

    @property
    def codegen(self) -> "_NoEnvironments":
        return _NoEnvironments()

    def serialize_using_object_code(self) -> tuple[str, str, bytes]:
        serialized: tuple[str, str, bytes] = self.serialize_using_bitcode()
        return serialized

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class _NoEnvironments:
    """Rejects Python objects: numba looks up its environment here if code refers to any."""

    @staticmethod
    def set_env(name: str, environment: Any) -> None:  # noqa: ANN401
        pass


class _Into(FunctionPass):
    kind: type[JITCodeLibrary]

    def __init__(self) -> None:
        FunctionPass.__init__(self)  # abstract in numba

    def run_pass(self, state: Any) -> bool:  # noqa: ANN401
        state.library = self.kind(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return False


@register_pass(mutates_CFG=False, analysis_only=True)
class _IntoKernel(_Into):
    _name, kind = "into_kernel", _Kernel


@register_pass(mutates_CFG=False, analysis_only=True)
class _IntoPart(_Into):
    _name, kind = "into_part", _Part


def _pipelines(state: Any, into: type[_Into]) -> list[Any]:  # noqa: ANN401
    passes = DefaultPassBuilder.define_nopython_pipeline(state)
    passes.add_pass_after(into, IRProcessing)
    passes.finalize()
    return [passes]


def _defined(module: Any) -> Iterable[str]:  # noqa: ANN401
    for one in (*module.functions, *module.global_variables):
        if not one.is_declaration:
            yield one.name
