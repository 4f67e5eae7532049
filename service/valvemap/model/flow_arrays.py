"""The arrays of one `FlowMap`, as its kernels take them; its last rows and its operators."""

from typing import Final

import numpy as np

from valvemap.model.flow_map_state import FlowMapState
from valvemap.model.kernels import (
    flow_cells,
    flow_drift,
    flow_memory,
    flow_path,
    flow_play,
    flow_slopes,
)
from valvemap.model.kernels.flow_basis import Axis
from valvemap.model.samples import Floats

NO_CELLS: Final = np.zeros((0, flow_cells.COLUMNS), np.float32)
NO_SLOPES: Final = np.zeros((0, flow_slopes.COLUMNS), np.float32)
NO_ROWS: Final = np.zeros((0, flow_path.COLUMNS), np.float32)
Both = tuple[Axis, Axis]


def memory_of(state: FlowMapState) -> flow_memory.Memory:
    """Arrays of one valve as the kernels take them."""
    return flow_memory.Memory(*(getattr(state, name) for name in flow_memory.Memory._fields))


def bare_memory(state: FlowMapState) -> flow_memory.Memory:
    """`memory_of` without cells and rows: results are published without them."""
    return memory_of(state)._replace(cells=NO_CELLS, slopes=NO_SLOPES, recent=NO_ROWS)


def new_room() -> flow_memory.Room:
    """Room for the kernels to work in."""
    shape = 2, flow_drift.MODELS, flow_drift.STATES + 1, flow_drift.STATES
    return flow_memory.Room(
        np.empty((4, 3)), np.empty(shape), np.empty(flow_memory.AT), np.empty(8)
    )


def rows_of(state: FlowMapState) -> Floats:
    """The last samples in the order of time."""
    seen, many = int(state.counters[flow_memory.ROWS_SEEN]), len(state.recent)
    rows = state.recent[:seen] if seen <= many else np.roll(state.recent, -(seen % many), axis=0)
    return np.array(rows, np.float64)


def given_of(state: FlowMapState) -> Floats:
    """Parameters (PARAMETERS,) of the operators in use."""
    given = state.path[: flow_path.PARAMETERS].copy()
    given[flow_path.PLAY] = state.play[flow_play.HALF]
    return given
