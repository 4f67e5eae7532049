"""The newest samples, in a ring: signals as they were at one of them."""

from valvemap.model.kernels import flow_path as paths
from valvemap.model.kernels.compiled import inner
from valvemap.model.kernels.flow_memory import ROWS_SEEN, Memory


@inner
def commanded(row: int, memory: Memory) -> tuple[float, float]:
    """U at a row that is kept, and its standard deviation."""
    recent, behind = memory.recent, ahead(row, memory)
    known = min(memory.counters[ROWS_SEEN], len(recent)) - behind
    return paths.commanded(recent, row, known, behind, memory.path)


@inner
def between(row: int, column: int, period: float, memory: Memory) -> tuple[float, float]:
    """A signal at a row that is kept, and its standard deviation."""
    recent, behind = memory.recent, ahead(row, memory)
    known = min(memory.counters[ROWS_SEEN], len(recent)) - behind
    return paths.between(recent, row, known, behind, column, period)


@inner
def ahead(row: int, memory: Memory) -> int:
    """How many rows were seen since ``row``."""
    newest = (memory.counters[ROWS_SEEN] - 1) % len(memory.recent)
    return int((newest - row) % len(memory.recent))
