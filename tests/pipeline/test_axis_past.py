"""An axis drops the rows of a sudden change from its sums once the change is found."""

from dataclasses import replace

import numpy as np
import pytest

from valvemap.model.axis import AxisGeometry, AxisRegression
from valvemap.model.kernels.flow_drift import EDGE, GAIN
from valvemap.pipeline.axis_past import KEPT, STEP_S, Past

REGRESSION = AxisRegression(AxisGeometry(63, 45, 800, 1.2, 1.2), play_percent=2.0, spool_hz=40.0)


def state_of(rows, gain=0.0, gain_std=0.001, shift=0.0):
    """A state with this number of rows; gain and shift of the edge AT."""
    state = REGRESSION.initial_state()
    now = np.zeros_like(state.drift_now)
    now[1, 0, GAIN], now[1, 0, EDGE] = gain, shift
    now[:, 1 + GAIN, GAIN], now[:, 1 + EDGE, EDGE] = gain_std**2, 0.01**2
    squares = np.array([0.0, 0.0, rows])
    return replace(state, M=rows * np.eye(len(state.M)), squares=squares, drift_now=now)


def lived(*rows):
    past = Past()
    for many in rows:
        past = past.after(state_of(many), STEP_S)
    return past


@pytest.mark.parametrize("moved", [{"gain": -0.3}, {"gain": 0.1}, {"shift": 1.0}])
def test_a_change_that_is_found_drops_the_rows_of_the_last_seconds(moved):
    past = lived(*range(100, 1000, 100))
    now = state_of(1000.0, **moved)
    after, state = past.without_change(now)
    assert state.squares[2] == 1000.0 - KEPT * 100.0
    assert np.array_equal(state.M, state.squares[2] * np.eye(len(state.M)))
    assert np.array_equal(state.drift_now, now.drift_now)
    assert after.without_change(state)[1] is state  # once


def test_the_second_edge_drops_what_was_summed_since_the_first():
    after, state = lived(100, 200, 300).without_change(state_of(400.0, gain=-0.3))
    after = after.after(state_of(500.0, gain=-0.3), STEP_S)
    later = state_of(600.0, gain=-0.3, shift=1.0)
    assert after.without_change(later)[1].squares[2] == state.squares[2] == 100.0


@pytest.mark.parametrize("doubted", [{"gain": -0.003}, {"gain": -0.3, "gain_std": 0.1}])
def test_nothing_is_dropped_for_a_change_in_doubt(doubted):
    past, now = lived(100, 200, 300), state_of(400.0, **doubted)
    assert past.without_change(now) == (past, now)


def test_states_are_kept_step_by_step_of_movement():
    past = Past()
    for k in range(100):
        past = past.after(state_of(float(k)), 0.1 * STEP_S)
    assert [state.squares[2] for state in past.states] == [70.0, 80.0, 90.0]


def test_without_a_past_nothing_is_dropped():
    now = state_of(10.0, gain=-0.3)
    assert Past().without_change(now)[1] is now
