"""A fit of `FlowMap`, and the map behind a meter, on states made by hand."""

import numpy as np
import pytest

from valvemap.model import flow_fits, flow_map_looks
from valvemap.model.flow_map import FlowMap
from valvemap.model.flow_map_state import axes
from valvemap.model.kernels import flow_fit, flow_memory, flow_path
from valvemap.model.samples import Samples

OF_ONE_CELL = 711  # U 98.75-100 %, s below the first knot
RATE = 100.0  # Hz


@pytest.fixture
def both():
    flow_map = FlowMap()
    return axes(flow_map.U_range, flow_map.dp_range)


def of_one_cell():
    """The cooling circuit of docs/accuracy.md after 13 hours: one cell, worth 2.4 samples."""
    state = FlowMap().initial_state()
    state.cells[OF_ONE_CELL, :8] = 94.0, 2.44, 100.0, 0.2337, 9.333, 0.0, 5.1e-4, 0.0
    state.scalars[: flow_fit.WITHIN_WEIGHT + 1] = [
        *(5.82e6, 3.66e5, 3.29e8, 8.4e-4),  # precisions of the prior
        *(9.8e-3, 9.8e-7, 88.4, 2.1, 214.0),  # σ², δ², Q², squares within cells, their number
    ]
    state.scalars[flow_fit.SCALE_BEFORE] = 88.4
    return state


def test_a_map_that_refuses_its_only_cell_is_not_the_likelier_one(both):
    fitted, fresh = of_one_cell(), of_one_cell()
    assert flow_fits.fit(fitted, *both, 2, fresh=False)
    assert flow_fits.fit(fresh, *both, 8, fresh=True)
    at = np.array([100.0]), np.array([0.2337**2]), np.array([40.0])
    fitted.counters[flow_memory.FITTED] = fresh.counters[flow_memory.FITTED] = 1
    (known,), (refused,) = (flow_map_looks.predict(x, both, *at)[0] for x in (fitted, fresh))
    assert known == pytest.approx(9.333, rel=0.01)
    assert abs(refused) < 1.0  # the first guess takes the cell for an outlier
    evidence = [x.scalars[flow_fit.EVIDENCE] for x in (fitted, fresh)]
    assert evidence[0] > evidence[1]


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_what_a_meters_lag_shows_is_no_flow_against_the_pressure_drop(way):
    # A map that rises by .2·s l/min per %, from 0 at U = 10 %: below, the splines go on downwards.
    flow_map = FlowMap(U_range=(-100.0, 100.0))
    axis_U, axis_s = axes(flow_map.U_range, flow_map.dp_range)
    state = flow_map.initial_state()
    rise = 0.2 * (axis_U.sites[:, None] - 10.0 * way) * axis_s.sites
    state.theta[:] = rise.ravel()
    state.counters[[flow_memory.FITTED, flow_memory.USED]] = 1, 5000
    state.counters[[flow_memory.NEXT_FIT, flow_memory.NEXT_LOOK]] = 10**6
    state.path[flow_path.LAG_Q] = lag = 0.2
    after = np.arange(1, 121) / RATE
    U = way * np.concatenate([np.full(150, 40.0), np.ones(120)])
    t = np.arange(len(U)) * round(1e9 / RATE)
    shown = way * np.concatenate([np.full(150, 60.0), 60.0 * np.exp(-after / lag)])
    samples = Samples.of(t, U, np.full(len(U), 100.0), 0.0 * U, shown)
    _, trace = flow_map.update(state, samples)
    np.testing.assert_allclose(trace.predicted[140:], shown[140:], atol=1.5)
