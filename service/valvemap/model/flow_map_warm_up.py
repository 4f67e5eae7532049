"""Runs every kernel of `FlowMap` once, in parts that share hardly any: so they are compiled."""

import numpy as np

from valvemap.model import flow_fits
from valvemap.model.flow_arrays import memory_of
from valvemap.model.flow_evidence import Evidence, with_value
from valvemap.model.flow_map import FlowMap
from valvemap.model.flow_map_state import FlowMapState, axes
from valvemap.model.kernels import flow_cells, flow_fit, flow_path, flow_play, flow_stay
from valvemap.model.samples import Samples

ROWS = 8


def learn() -> None:
    """Learn from a few samples, and say what the map knows: too few samples for a fit."""
    k = np.arange(ROWS)
    flow_map = FlowMap()
    samples = Samples.of(k, 10.0 * k, 10.0 * k, 0.0 * k, 1.0 * k)
    state, _ = flow_map.update(flow_map.initial_state(), samples)
    flow_map.parameters(state)
    flow_map.adaptation(state)
    flow_map.inverted(state, *np.ones((3, 1)))


def fit() -> None:
    """Fit the map of one cell."""
    state, both = _blank(), axes((0.0, 100.0), (0.0, 200.0))
    state.cells[0, [flow_cells.COUNT, flow_cells.WORTH]] = 1.0
    state.scalars[flow_fit.SCALE] = 1.0
    flow_fits.fit(state, *both, 1, fresh=True)


def look() -> None:
    """Compare what operators leave of a few rows."""
    both, given = axes((0.0, 100.0), (0.0, 200.0)), np.zeros(flow_path.PARAMETERS)
    evidence = Evidence(*both, np.ones((ROWS, flow_path.COLUMNS)))
    evidence.whitened(evidence.of(given).residual, evidence.noise(given))
    evidence.fill(given, *both, _blank().theta)
    evidence.of(with_value(given, flow_path.HELD_U, 1.0))


def begin_again() -> None:
    """Begin the map again, and follow a path through a play."""
    state = _blank()
    flow_path.has_past(state.path)
    flow_path.has_past(state.path[: flow_path.PARAMETERS])
    flow_stay.begin_replay(memory_of(state), 0, np.nan)
    flow_stay.forget_motion(memory_of(state))
    flow_play.behind(1.0, np.zeros(1), np.zeros(1))


def _blank() -> FlowMapState:
    return FlowMap().initial_state()
