"""What `FlowMap` does between samples: fits, searches for operators, and a new start of the map."""

import math

import numpy as np

from valvemap.model import flow_causes, flow_evidence
from valvemap.model.flow_arrays import (
    Both,
    bare_memory,
    given_of,
    memory_of,
    new_room,
    rows_of,
)
from valvemap.model.flow_fits import refit
from valvemap.model.flow_map_state import FlowMapState
from valvemap.model.flow_restart import begin_again
from valvemap.model.flow_rivals import Rivals
from valvemap.model.kernels import (
    flow_cells,
    flow_inverse,
    flow_look,
    flow_memory,
    flow_path,
    flow_play,
    flow_run,
    flow_slopes,
    flow_stay,
)
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.samples import Codes, Floats


def learn(state: FlowMapState, both: Both, batch: flow_memory.Batch, start: int, stop: int) -> None:
    """Learn from the rows ``start`` … ``stop`` - 1 of a batch; the state is written in place."""
    memory, room, counters, row = memory_of(state), new_room(), state.counters, start
    while row < stop:
        began = counters[flow_memory.BEGAN]
        row = flow_run.run(row, stop, batch, *both, memory, room)
        T = float(batch.T[row - 1])
        T = T if abs(T) < rules.HUGE else math.nan
        if counters[flow_memory.BEGAN] != began:
            begin_again(state, both, T, batch.longest)
        if counters[flow_memory.USED] >= counters[flow_memory.NEXT_FIT]:
            refit(state, *both)
            if counters[flow_memory.DOUBTED]:
                _doubt(state, both)
            _watch(state, both)
            if counters[flow_memory.ROWS_SEEN] - counters[flow_memory.WEIGHED] >= rules.ROWS:
                _weigh(state, both)
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


def _weigh(state: FlowMapState, both: Both) -> None:
    """Weigh the operators in use against their rivals; search at once where one is likelier."""
    counters, given = state.counters, given_of(state)
    counters[flow_memory.WEIGHED] = counters[flow_memory.ROWS_SEEN]
    rivals = Rivals(state.rivals, given)
    if rivals.best > 0.0 and counters[flow_memory.USED] < counters[flow_memory.NEXT_LOOK]:
        before = rivals.best
        flow_causes.weigh(flow_evidence.Evidence(*both, rows_of(state)), given, rivals)
        if before < rules.CLEAR <= rivals.best:
            counters[flow_memory.NEXT_LOOK] = counters[flow_memory.USED]


def _look(state: FlowMapState, both: Both, T: float, longest: float) -> None:
    """Search for operators; where others are found, the map begins again."""
    counters, path, play = state.counters, state.path, state.play
    used = int(counters[flow_memory.USED])
    later = (at for at in rules.LOOKS if at > used)
    counters[flow_memory.NEXT_LOOK] = next(later, used + rules.MOST_BETWEEN_LOOKS)
    counters[flow_memory.WEIGHED] = counters[flow_memory.ROWS_SEEN]
    given = given_of(state)
    rows = rows_of(state)
    evidence = flow_evidence.Evidence(*both, rows)
    rivals = Rivals(state.rivals, given)
    found, gains = flow_causes.search(evidence, given, rivals)
    of = path[flow_path.GAINS : flow_path.GAINS + flow_path.PARAMETERS]
    of += gains
    of[(found == 0.0) & (np.arange(flow_path.PARAMETERS) != flow_path.LEAST)] = 0.0
    if found[flow_path.PLAY]:
        left, noise = evidence.of(found).square, flow_evidence.noise_of(rows[:, flow_path.LEFT_Q])
        path[flow_path.HYSTERESIS] += _sign(left > rules.OTHER_HYSTERESIS * noise**2)
    path[flow_path.NEWS] = found[flow_path.NEWS]
    of_found = flow_evidence.precision(evidence, found)
    if _differ(found, given, evidence.gain(found, given)):
        if ((found > 0.0) != (given > 0.0)).any():
            rivals.forget()
            counters[flow_memory.NEXT_LOOK] = used + rules.LOOKS[1]
        path[: flow_path.PARAMETERS] = found
        play[flow_play.HALF] = found[flow_path.PLAY]
        path[flow_path.PLAY] = 0.0  # that of the spool is in `play`
        path[flow_path.PHASE] = evidence.of(found).phase
        state.precision[:] = of_found
        held = slice(flow_path.HELD_U, flow_path.PARAMETERS)
        if (found == given)[: flow_path.TOP].all() and (found == given)[held].all():
            _empty_bounds(state, both)
        else:
            change = evidence.of(given).square - evidence.of(found).square
            if (found != given)[[flow_path.CHOKE, flow_path.KNEE]].any():
                change = math.inf  # samples lie in other cells now
            begin_again(state, both, T, longest, change)
        _refine(state, both, evidence, np.zeros_like(found))
    else:
        state.precision[:] += of_found
        known = state.precision.astype(np.float64)
        ks = flow_evidence.smooth(found)
        moved = np.zeros_like(found)
        if ks:
            weighed = of_found[np.ix_(ks, ks)] @ (found - given)[ks]
            moved[ks] = flow_evidence.solved(known[np.ix_(ks, ks)], weighed)
        _refine(state, both, evidence, moved)


def _refine(
    state: FlowMapState, both: Both, evidence: flow_evidence.Evidence, moved: Floats
) -> None:
    """Move the operators' parameters and, by its derivatives, the map; note the doubt left."""
    at = given_of(state)
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
    now = np.maximum(at + moved, 0.0)
    state.play[flow_play.HALF] = now[flow_path.PLAY]
    now[flow_path.PLAY] = 0.0  # that of the spool is in `play`
    state.path[: flow_path.PARAMETERS] = now


def _doubt(state: FlowMapState, both: Both) -> None:
    """Find the meter's end, reached for the first time; take a change back that it is."""
    counters, path = state.counters, state.path
    was_called = counters[flow_memory.DOUBTED] == flow_memory.A_CHANGE
    counters[flow_memory.DOUBTED] = 0
    given = given_of(state)
    if given[flow_path.TOP]:
        return
    rows = rows_of(state)
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
    refit(state, *both)


def _sign(says_so: bool) -> float:  # noqa: FBT001
    return 1.0 if says_so else -1.0


def _watch(state: FlowMapState, both: Both) -> None:
    """Weigh whether the meter has a least flow, by the samples since the last time."""
    path, counters = state.path, state.counters
    seen = int(counters[flow_memory.ROWS_SEEN] - counters[flow_memory.WATCHED])
    rows = rows_of(state)
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
        evidence = flow_evidence.Evidence(*both, rows_of(state))
        least *= flow_causes.has_least(evidence, given_of(state), least)
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


def _differ(found: Floats, given: Floats, gain: float) -> bool:
    """Whether the map would be another one: other operators, or values clearly likelier."""
    there = np.arange(flow_path.PARAMETERS) != flow_path.NEWS  # changes nothing of the map
    if ((found > 0.0) != (given > 0.0))[there].any():
        return True
    ks = flow_evidence.smooth(found)
    is_other = bool((np.abs(found - given) > rules.OTHER * found)[ks].any())
    return is_other and gain >= rules.STILL_CLEAR
