"""Prefetch of the next valve's state, which with thousands of valves is not in the cache.

A batch processes the valves one after another. The state of each consists of some twenty arrays,
which together exceed every cache. The next state is fetched while the current valve is processed;
results do not change. For functions compiled with `kernels.compiled` or plain numba.
"""

from typing import TYPE_CHECKING, Any

from valvemap.numba_version import is_left_out

__all__ = ["fetch"]

if TYPE_CHECKING or is_left_out():

    def fetch(_arrays: Any, _row: int) -> None:  # noqa: ANN401
        """Do nothing: plain Python has no prefetch."""

else:
    from valvemap.model.kernels.prefetch_instruction import fetch
