"""What `FlowMap` does between samples: fits, searches for operators, and a new start of the map."""

import math
from typing import Final

import numpy as np

from valvemap.model import flow_causes, flow_evidence
from valvemap.model.fleet import copied
from valvemap.model.flow_map_state import FlowMapState
from valvemap.model.kernels import (
    flow_cells,
    flow_drift,
    flow_fit,
    flow_inverse,
    flow_look,
    flow_memory,
    flow_oil,
    flow_path,
    flow_play,
    flow_run,
    flow_slopes,
    flow_stay,
)
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.flow_basis import Axis
from valvemap.model.samples import Codes, Floats, Times

NANOSECONDS: Final = 1e9
NO_CELLS: Final = np.zeros((0, flow_cells.COLUMNS), np.float32)
NO_SLOPES: Final = np.zeros((0, flow_slopes.COLUMNS), np.float32)
NO_ROWS: Final = np.zeros((0, flow_path.COLUMNS), np.float32)
Both = tuple[Axis, Axis]


def memory_of(state: FlowMapState) -> flow_memory.Memory:
    """Arrays of one valve as the kernels take them."""
    return flow_memory.Memory(*(getattr(state, name) for name in flow_memory.Memory._fields))


def new_room() -> flow_memory.Room:
    """Room for the kernels to work in."""
    shape = 2, flow_drift.MODELS, flow_drift.STATES + 1, flow_drift.STATES
    return flow_memory.Room(
        np.empty((4, 3)), np.empty(shape), np.empty(flow_memory.AT), np.empty(8)
    )


def learn(state: FlowMapState, both: Both, batch: flow_memory.Batch, start: int, stop: int) -> None:
    """Learn from the rows ``start`` … ``stop`` - 1 of a batch; the state is written in place."""
    memory, room, counters, row = memory_of(state), new_room(), state.counters, start
    while row < stop:
        began = counters[flow_memory.BEGAN]
        row = flow_run.run(row, stop, batch, *both, memory, room)
        T = float(batch.T[row - 1])
        T = T if abs(T) < rules.HUGE else math.nan
        if counters[flow_memory.BEGAN] != began:
            _replay(state, both, T, batch.longest)
        if counters[flow_memory.USED] >= counters[flow_memory.NEXT_FIT]:
            _refit(state, *both)
            if counters[flow_memory.DOUBTED]:
                _doubt(state, both)
            _watch(state, both)
            if counters[flow_memory.USED] >= counters[flow_memory.NEXT_LOOK]:
                _look(state, both, T, batch.longest)


def predict(
    state: FlowMapState, both: Both, U: Floats, dp: Floats, T: Floats
) -> tuple[Floats, Floats]:
    """Flow (N,) and its standard deviation (N,), l/min; NaN where they are not known."""
    Q, std = np.empty((2, len(U)))
    flow_look.evaluate(*both, bare_memory(state), U, dp, T, Q, std, new_room())
    return Q, std


def invert(
    state: FlowMapState, both: Both, Q: Floats, dp: Floats, T: Floats
) -> tuple[Floats, Floats, Floats, Codes]:
    """U, U without its bounds, dQ/dU and status, all (N,), see `kernels.flow_inverse`."""
    U, unclipped, slope = np.empty((3, len(Q)))
    status = np.empty(len(Q), np.uint8)
    flow_inverse.invert(
        *both, bare_memory(state), Q, dp, T, U, unclipped, slope, status, new_room()
    )
    return U, unclipped, slope, status


def bare_memory(state: FlowMapState) -> flow_memory.Memory:
    """`memory_of` without cells and rows: results are published without them."""
    return memory_of(state)._replace(cells=NO_CELLS, slopes=NO_SLOPES, recent=NO_ROWS)


def _look(state: FlowMapState, both: Both, T: float, longest: float) -> None:
    """Search for operators; where others are found, the map begins again."""
    counters, path, play = state.counters, state.path, state.play
    used = int(counters[flow_memory.USED])
    later = (at for at in rules.LOOKS if at > used)
    counters[flow_memory.NEXT_LOOK] = next(later, used + rules.MOST_BETWEEN_LOOKS)
    given = _given(state)
    rows = _rows(state)
    evidence = flow_evidence.Evidence(*both, rows)
    found, gains = flow_causes.search(evidence, given)
    of = path[flow_path.GAINS : flow_path.GAINS + flow_path.PARAMETERS]
    of += gains
    of[(found == 0.0) & (np.arange(flow_path.PARAMETERS) != flow_path.LEAST)] = 0.0
    if found[flow_path.PLAY]:
        left, noise = evidence.of(found).square, flow_evidence.noise_of(rows[:, flow_path.LEFT_Q])
        path[flow_path.HYSTERESIS] += _sign(left > rules.OTHER_HYSTERESIS * noise**2)
    path[flow_path.NEWS] = found[flow_path.NEWS]
    of_found = flow_evidence.precision(evidence, found)
    if _differ(found, given, of_found, state.precision.astype(np.float64)):
        path[: flow_path.PARAMETERS] = found
        play[flow_play.HALF] = found[flow_path.PLAY]
        path[flow_path.PLAY] = 0.0  # that of the spool is in `play`
        path[flow_path.PHASE] = evidence.of(found).phase
        state.precision[:] = of_found
        held = slice(flow_path.HELD_U, flow_path.PARAMETERS)
        if (found == given)[: flow_path.TOP].all() and (found == given)[held].all():
            _empty_bounds(state, both)
        else:
            _replay(state, both, T, longest)
        _refine(state, both, evidence, np.zeros_like(found))
    else:
        state.precision[:] += of_found
        known = state.precision.astype(np.float64)
        ks = [k for k in flow_evidence.smooth(found) if k != flow_path.PLAY]
        moved = np.zeros_like(found)
        if ks:
            weighed = of_found[np.ix_(ks, ks)] @ (found - given)[ks]
            moved[ks] = flow_evidence.solved(known[np.ix_(ks, ks)], weighed)
        _refine(state, both, evidence, moved)


def _refine(
    state: FlowMapState, both: Both, evidence: flow_evidence.Evidence, moved: Floats
) -> None:
    """Move the operators' parameters and, by its derivatives, the map; note the doubt left."""
    at = _given(state)
    ks = flow_evidence.smooth(at)
    state.doubt[:] = 0.0
    if not ks:
        return
    slopes = np.array([evidence.moved(at, k, *both) for k in ks])
    known = state.precision[np.ix_(ks, ks)].astype(np.float64)
    covariance = flow_evidence.solved(known, np.eye(len(ks)))
    state.doubt[:] = np.sqrt(np.einsum("ki,kl,li->i", slopes, covariance, slopes))
    by = np.einsum("k,ki->i", moved[ks], slopes)
    state.theta[:] += by
    flow_cells.shift(*both, by, state.cells, new_room().work)
    flow_slopes.shift(*both, by, state.cells, state.slopes, new_room().work)
    state.path[: flow_path.PARAMETERS] += moved


def _doubt(state: FlowMapState, both: Both) -> None:
    """Find the meter's end, reached for the first time; take a change back that it is."""
    counters, path = state.counters, state.path
    was_called = counters[flow_memory.DOUBTED] == flow_memory.A_CHANGE
    counters[flow_memory.DOUBTED] = 0
    given = _given(state)
    if given[flow_path.TOP]:
        return
    rows = _rows(state)
    top = flow_causes.end_of_meter(flow_evidence.Evidence(*both, rows), given)
    if top and not (was_called and _was_reached(rules.NEAR_TOP * top, rows, state)):
        path[flow_path.TOP], path[flow_path.GAINS + flow_path.TOP] = top, rules.CLEAR
        counters[flow_memory.CHANGES] -= int(was_called)
        _empty_bounds(state, both)


def _was_reached(flow: float, rows: Floats, state: FlowMapState) -> bool:
    """Whether the meter showed such a flow before the newest half of the rows."""
    shown = np.abs(rows[:, flow_path.LEFT_Q]) >= flow
    older, newer = shown[: len(rows) // 2], shown[len(rows) // 2 :]
    known = np.abs(state.cells[:, flow_cells.MEAN_Q]) >= flow
    many = state.cells[known, flow_cells.COUNT].sum() - np.count_nonzero(newer)
    return bool(np.count_nonzero(older) > 1 or many > 1)


def _empty_bounds(state: FlowMapState, both: Both) -> None:
    """Empty the cells at the ends of the meter, and reset drift and changes."""
    cells, path = state.cells, state.path
    size = np.abs(cells[:, flow_cells.MEAN_Q])
    beyond = size > rules.PARTLY_BEYOND * path[flow_path.TOP]
    wrong = (size < 2.0 * path[flow_path.LEAST]) | (beyond & bool(path[flow_path.TOP]))
    cells[wrong] = 0.0
    flow_stay.forget_motion(memory_of(state))
    state.counters[flow_memory.FITTED] = 0
    _refit(state, *both)


def _given(state: FlowMapState) -> Floats:
    given = state.path[: flow_path.PARAMETERS].copy()
    given[flow_path.PLAY] = state.play[flow_play.HALF]
    return given


def _sign(says_so: bool) -> float:  # noqa: FBT001
    return 1.0 if says_so else -1.0


def _watch(state: FlowMapState, both: Both) -> None:
    """Weigh whether the meter has a least flow, by the samples since the last time."""
    path, counters = state.path, state.counters
    seen = int(counters[flow_memory.ROWS_SEEN] - counters[flow_memory.WATCHED])
    rows = _rows(state)
    new = flow_evidence.new_readings(rows)
    rows = rows[-seen:][new[-seen:]] if seen > 0 else np.empty((0, flow_path.COLUMNS))
    counters[flow_memory.WATCHED] = counters[flow_memory.ROWS_SEEN]
    Q = rows[:, flow_path.LEFT_Q]
    if len(Q) < rules.SEEN_BELOW:
        return
    noise = flow_evidence.noise_of(Q)
    _watch_pump(path, rows, noise)
    before, at = path[flow_path.LEAST_SEEN], flow_path.GAINS + flow_path.LEAST
    least, gain = flow_causes.least_shown(Q, noise)
    if before > 0.0 and least < rules.SAME_LEAST * before:
        path[at] = 0.0  # refuted
    if before == 0.0 or least < before:
        path[flow_path.LEAST_SEEN] = least if math.isfinite(least) else 0.0
    path[at] += gain
    least = float(path[flow_path.LEAST_SEEN]) if path[at] >= rules.CLEAR else 0.0
    was_there = path[flow_path.LEAST] > 0.0
    if least and not was_there:
        evidence = flow_evidence.Evidence(*both, _rows(state))
        least *= flow_causes.has_least(evidence, _given(state), least)
    path[flow_path.LEAST] = least
    if was_there != (least > 0.0):
        _empty_bounds(state, both)


def _watch_pump(path: Floats, rows: Floats, noise: float) -> None:
    """Weigh whether the largest flow is that of the pump; a larger one refutes it."""
    level, gain = flow_causes.most_delivered(rows, noise)
    width = rules.MOST_STAY * noise
    if level > path[flow_path.MOST] + width:
        path[flow_path.MOST], path[flow_path.MOST_GAIN] = level, max(gain, 0.0)
    elif level > path[flow_path.MOST] - width:
        path[flow_path.MOST_GAIN] = max(path[flow_path.MOST_GAIN] + gain, 0.0)


def _differ(found: Floats, given: Floats, of_found: Floats, of_given: Floats) -> bool:
    """Whether the map would be another one: other operators, or parameters beyond doubt."""
    there = np.arange(flow_path.PARAMETERS) != flow_path.NEWS  # changes nothing of the map
    ks = [int(k) for k in np.flatnonzero(there & (found > 0.0) & (given > 0.0))]
    ks = [k for k in ks if k < flow_path.OF_MAP]
    if ((found > 0.0) != (given > 0.0))[there].any():
        return True
    off, square = (found - given)[ks], 0.0
    both = [of[np.ix_(ks, ks)] for of in (of_found, of_given)]
    if all(np.diagonal(of).all() for of in both):
        sum_of = sum(flow_evidence.solved(of, np.eye(len(ks))) for of in both)
        square = float(off @ np.linalg.solve(sum_of, off))
    return bool(square > 2.0 * rules.CLEAR) and bool((np.abs(off) > rules.OTHER * found[ks]).any())


def _rows(state: FlowMapState) -> Floats:
    """The last samples in the order of time."""
    seen, many = int(state.counters[flow_memory.ROWS_SEEN]), len(state.recent)
    rows = state.recent[:seen] if seen <= many else np.roll(state.recent, -(seen % many), axis=0)
    return np.array(rows, np.float64)


def _replay(state: FlowMapState, both: Both, T: float, longest: float) -> None:
    """Begin the map again, with the last samples."""
    rows = _rows(state)
    N = len(rows)
    t = _times(rows, int(state.counters[flow_memory.LAST_TIME]))
    memory, room, counters = memory_of(state), new_room(), state.counters
    flow_stay.begin_replay(memory, N, T)
    predicted, residual = np.empty((2, N))
    batch = flow_memory.Batch(
        t=t,
        U=rows[:, flow_path.LEFT_U].copy(),
        dp=rows[:, flow_path.LEFT_DP].copy(),
        p1=rows[:, flow_path.LEFT_P1].copy(),
        T=np.full(N, T),
        Q=rows[:, flow_path.LEFT_Q].copy(),
        usable=np.ones(N, np.bool_),
        predicted=predicted,
        residual=residual,
        status=np.empty(N, np.uint8),
        longest=longest,
    )
    counters[flow_memory.WATCHED] = N
    _begin_coarse(state, both, rows)
    flow_run.run(0, N, batch, *both, memory, room)
    counters[flow_memory.RESTARTED] = counters[flow_memory.USED]
    counters[flow_memory.FITTED] = 0  # the next fit starts from the first guess
    _refit(state, *both)


def _begin_coarse(state: FlowMapState, both: Both, rows: Floats) -> None:
    """Take the coarse map of the rows until all are learnt: a meter's filter is undone by it."""
    given = _given(state)
    evidence = flow_evidence.Evidence(*both, rows)
    left = evidence.of(given).square
    evidence.fill(given, *both, state.theta)
    scale = float(state.scalars[flow_fit.SCALE])
    state.std[:] = rules.COARSE * math.sqrt(scale)
    state.scalars[flow_fit.VARIANCE] = left  # what it was before came from another map
    state.path[flow_path.FLOOR] = rules.OF_COARSE * left if flow_path.has_past(given) else 0.0
    state.counters[flow_memory.FITTED] = 1
    state.counters[flow_memory.NEXT_FIT] = state.counters[flow_memory.USED] + len(rows) + 1


def _times(rows: Floats, last: int) -> Times:
    steps = np.round(NANOSECONDS * rows[:, flow_path.STEP]).astype(np.int64)
    behind = np.cumsum(steps[::-1])[::-1]  # from the row before to the last one
    return np.asarray(last - behind + steps, np.int64)


def _refit(state: FlowMapState, axis_U: Axis, axis_s: Axis) -> None:
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
