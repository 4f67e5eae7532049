"""Converts the stored state of a valve to the present units of its signals, where that is exact."""

from dataclasses import replace

import numpy as np

from valvemap.model.estimator import StateMismatchError
from valvemap.model.flow_units import FlowHomogeneous, in_flow_unit, times
from valvemap.model.kernels import lack_of_fit
from valvemap.model.kernels import residual_spread as of_spread
from valvemap.model.samples import Floats
from valvemap.pipeline.kernels import score as of_score
from valvemap.pipeline.kernels.gate import Memory
from valvemap.pipeline.meaning import Rescaling
from valvemap.pipeline.quality_gate import GateState
from valvemap.pipeline.valve_memory import LaneNotes, ValveMemory
from valvemap.pipeline.valve_state import Lane


def lane_in_flow_unit(lane: Lane, factor: float) -> Lane:
    """Return the lane that the same samples with Q times ``factor`` > 0 would have given.

    Raises
    ------
    StateMismatchError
        if the estimator has no exact conversion.
    """
    estimator = lane.estimator
    powers = estimator.flow_powers(lane.state) if isinstance(estimator, FlowHomogeneous) else None
    if powers is None or not factor > 0.0:
        raise StateMismatchError("no exact conversion")
    spread = replace(
        lane.spread,
        cells=times(lane.spread.cells, _squares(of_spread.PLACES_OF_CELL, _OF_CELL), factor),
        overall=times(
            lane.spread.overall, _squares(of_spread.PLACES_OVERALL, [of_spread.SQUARES]), factor
        ),
    )
    return replace(
        lane,
        state=in_flow_unit(lane.state, powers, factor),
        score=replace(lane.score, sums=times(lane.score.sums, _OF_SCORE, factor)),
        spread=spread,
        support=replace(lane.support, fit=times(lane.support.fit, _of_fit(), factor)),
    )


def memory_in_units(memory: ValveMemory, changed: list[Rescaling], factor: float) -> ValveMemory:
    """Return a valve's memory with the values of its signals rescaled.

    ``changed`` has an entry per signal, in the order of the gate; ``factor`` is that of the flow in
    the last results.
    """
    gain = np.array([one.gain for one in changed])
    offset = np.array([one.offset for one in changed])

    def rescaled(values: Floats, shift: Floats = offset, scale: Floats = gain) -> Floats:
        return np.asarray(values * scale + shift)

    gate = memory.gate.memory
    window = rescaled(gate.window, offset[:, None], gain[:, None])
    kept = gate._asdict() | {"last": rescaled(gate.last), "window": window}
    before = memory.arrivals.waiting
    waiting = before._replace(
        values=rescaled(before.values), held_value=rescaled(before.held_value)
    )
    arrivals = memory.arrivals._replace(
        waiting=waiting, known=memory.arrivals.known.of_any_content()
    )
    notes = {
        name: LaneNotes(one.beyond, one.predicted * factor, one.residual * factor, one.status)
        for name, one in memory.notes.items()
    }
    T = float(memory.T * gain[-1] + offset[-1])
    state = GateState(Memory(**kept), memory.gate.bad_status)
    return replace(memory, gate=state, arrivals=arrivals, notes=notes, T=T)


def _squares(places: int, of: list[int]) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    powers = np.zeros(places, np.int64)
    powers[of] = 2
    return powers


_OF_CELL = [of_spread.SQUARES, of_spread.EXPECTED]
_OF_SCORE = _squares(of_score.FIELDS, [of_score.SQUARES, of_score.SCATTER_Q, of_score.RECENT])
_OF_SCORE[[of_score.MEAN_Q, of_score.LOWEST_Q, of_score.HIGHEST_Q, of_score.LARGEST]] = 1


def _of_fit() -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Return the powers of Q of the moments, in whose last row Q is, and of the scores' squares."""
    powers = np.zeros(lack_of_fit.PLACES, np.int64)
    row = lack_of_fit.TRIANGLE - lack_of_fit.WIDE
    for moments in (lack_of_fit.MOMENTS, lack_of_fit.PRESENT):
        powers[moments + row : moments + lack_of_fit.TRIANGLE] = 1
        powers[moments + lack_of_fit.TRIANGLE - 1] = 2
    powers[lack_of_fit.SPREAD : lack_of_fit.SEEN] = 2
    return powers
