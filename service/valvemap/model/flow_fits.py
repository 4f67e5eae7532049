"""When a `FlowMap` is fitted to its cells, and how."""

from valvemap.model.fleet import copied
from valvemap.model.flow_arrays import memory_of, new_room
from valvemap.model.flow_map_state import FlowMapState
from valvemap.model.kernels import flow_cells, flow_fit, flow_memory, flow_oil, flow_path
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.flow_basis import Axis


def refit(state: FlowMapState, axis_U: Axis, axis_s: Axis) -> None:
    """Fit the map, written in place, and set when the next fit is due."""
    counters = state.counters
    used = int(counters[flow_memory.USED] - counters[flow_memory.BEGAN])
    fitted = bool(counters[flow_memory.FITTED])
    rounds = rules.LATER_ROUNDS if fitted else rules.FIRST_ROUNDS
    counters[flow_memory.FITTED] = fit(state, axis_U, axis_s, rounds, fresh=not fitted)
    if used >= counters[flow_memory.NEXT_START]:
        counters[flow_memory.NEXT_START] = 2 * used
        other = copied(state)
        better = fit(other, axis_U, axis_s, rules.FIRST_ROUNDS, fresh=True)
        gained = other.scalars[flow_fit.EVIDENCE] - state.scalars[flow_fit.EVIDENCE]
        if better and not gained <= 0.0:
            counters[flow_memory.FITTED] = 1
            for name in ("theta", "std", "w", "v", "scalars"):
                getattr(state, name)[:] = getattr(other, name)
    counters[flow_memory.FITS] += 1
    floor = state.path[flow_path.FLOOR]
    state.scalars[flow_fit.VARIANCE] = max(state.scalars[flow_fit.VARIANCE], floor)
    if flow_path.has_past(state.path):  # what cells hold was corrected by earlier maps
        state.cells[:, [flow_cells.COUNT, flow_cells.WORTH]] *= rules.KEPT_BY_FILTERS
    ahead = min(max(used // rules.GROWTH, 1), rules.MOST_BETWEEN)
    counters[flow_memory.NEXT_FIT] = counters[flow_memory.USED] + ahead


def fit(state: FlowMapState, axis_U: Axis, axis_s: Axis, rounds: int, *, fresh: bool) -> int:
    """Fit the map, written in place; 0 where it could not be done."""
    cells, slopes = state.cells.copy(), state.slopes.copy()
    flow_oil.all_at_first(axis_s, memory_of(state), cells, slopes, new_room())
    arrays = cells, slopes, state.scalars, state.w, state.v, state.theta, state.std
    return int(flow_fit.fit(axis_U, axis_s, *arrays, rounds, fresh))
