"""What samples of a cell say of the slope along s: where a machine rests, nothing else does."""

import numpy as np
import pytest

from benchmarks import circumstances as c
from benchmarks.drawn_plants import drawn
from benchmarks.unseen_plants import judged
from valvemap.model.flow_map import FlowMap
from valvemap.model.kernels import flow_cells, flow_slopes
from valvemap.model.samples import Samples

RATE = 100.0  # Hz
OPEN = 62.0  # %


def rests(seed, levels, noise_of_dp):
    """An open valve that rests at these Δp in turn, 2 s each; true Δp, and samples."""
    N = int(2.0 * RATE) * len(levels)
    rng = np.random.default_rng([seed, 7])
    dp = np.repeat(levels, int(2.0 * RATE))
    t, U = np.arange(N) * int(1e9 / RATE), np.full(N, OPEN)
    Q = c.VALVES["ordinary"](U, dp) + rng.normal(0.0, 0.4, N)
    return Samples.of(t, U, dp + noise_of_dp * rng.standard_normal(N), 0 * dp, Q, 0 * dp + 40.0)


def moments(state):
    """Moments of the s before with s and Q, of the cell that has most samples."""
    number = int(np.argmax(state.cells[:, flow_cells.COUNT]))
    place = state.slopes[number % flow_slopes.PLACES]
    assert place[flow_slopes.OWNER] == number + 1
    return place[flow_slopes.WITH_S], place[flow_slopes.WITH_Q], state.cells[number]


def slope_of(dp):
    s, h = np.sqrt(dp), 1e-3
    low, high = (c.VALVES["ordinary"](np.array([OPEN]), (s + x) ** 2)[0] for x in (-h, h))
    return (high - low) / (2.0 * h)


@pytest.mark.parametrize("noise", [0.0, 2.0, 6.0])
def test_noise_of_dp_does_not_flatten_the_slope(noise):
    levels = np.random.default_rng(3).uniform(150.0, 190.0, 60)
    samples = rests(1, levels, noise)
    state, _ = FlowMap(lam=1 - 1e-6).update(FlowMap().initial_state(), samples)
    with_s, with_Q, cell = moments(state)
    assert with_Q / with_s == pytest.approx(slope_of(float(cell[flow_cells.MEAN_S]) ** 2), rel=0.1)


def test_where_only_noise_moves_dp_nothing_is_said_of_the_slope():
    """A line through such samples would be flat, and 20 standard errors off."""
    samples = rests(2, np.full(60, 170.0), 2.0)
    state, _ = FlowMap(lam=1 - 1e-6).update(FlowMap().initial_state(), samples)
    with_s, _, cell = moments(state)
    samples_of_it = cell[flow_cells.COUNT]
    said = abs(with_s) / np.sqrt(cell[flow_cells.VAR_S]) * slope_of(170.0)
    assert said < 4.0 * 0.4 / np.sqrt(samples_of_it)


@pytest.mark.parametrize("seed", [17001, 20019, 23105])
def test_maps_of_machines_that_rest_are_not_moved_by_what_their_cells_could_not_say(seed):
    """They were 1.8, .7 and .7 σ off with .31-.57 held: a slope at rest was taken for drift."""
    row, _ = drawn(seed)
    last = judged(row)[-1]
    assert last["rmse"] < 0.6
    assert last["held"] > 0.95


def test_a_cell_with_more_samples_keeps_its_place():
    known = np.zeros((flow_slopes.PLACES, flow_slopes.COLUMNS), np.float32)
    cells = np.zeros((2 * flow_slopes.PLACES, flow_cells.COLUMNS), np.float32)
    first, second = 5, 5 + flow_slopes.PLACES
    cells[first, flow_cells.COUNT], cells[second, flow_cells.COUNT] = 10.0, 9.0
    note = flow_slopes.note.py_func
    note(known, cells, first, 1.0, 2.0, 3.0, 0.1, 2.0)
    note(known, cells, second, 1.0, 2.0, 3.0, 0.1, 2.0)
    assert known[5, flow_slopes.OWNER] == first + 1
    cells[second, flow_cells.COUNT] = 11.0
    note(known, cells, second, 1.0, 2.0, 3.0, 0.1, np.nan)  # comes from another cell
    assert known[5, flow_slopes.OWNER] == first + 1
    note(known, cells, second, 1.0, 2.0, 3.0, 0.1, 2.0)
    assert known[5, flow_slopes.OWNER] == second + 1
