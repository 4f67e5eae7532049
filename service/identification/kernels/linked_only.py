"""How numba compiles what only kernels call: to be linked into them, and for nothing else.

Numba optimises each function by itself, makes machine code of it, and optimises it once more in
every kernel that it is linked into. The first two are for callers from Python, of which an inner
function has none: without them a first start takes an eighth less.
"""

from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.untyped_passes import IRProcessing


class OnlyLinked(CompilerBase):
    """Numba's own pipeline, into a `_Part` of kernels: option ``pipeline_class`` of a function."""

    def define_pipelines(self) -> list[Any]:
        """Numba's passes, and where their code goes."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_IntoPart, IRProcessing)
        passes.finalize()
        return [passes]


@register_pass(mutates_CFG=False, analysis_only=True)
class _IntoPart(FunctionPass):
    _name = "into_part"

    def __init__(self) -> None:
        FunctionPass.__init__(self)  # abstract in numba

    def run_pass(self, state: Any) -> bool:  # noqa: ANN401
        state.library = _Part(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return False


class _Part(JITCodeLibrary):
    """Code as lowered. Private seams of numba: the names with an underscore."""

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
    """Python's objects that compiled code refers to: there is no place for them here."""

    @staticmethod
    def set_env(name: str, environment: Any) -> None:  # noqa: ANN401
        if environment.consts:
            raise TypeError(f"{name} refers to Python's objects: what only kernels call must not")
