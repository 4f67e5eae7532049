"""Additional notes on the claims, computed for one set of recordings since they are slow."""

import numpy as np

from paper.evidence import Evidence
from paper.learning import error_of, learnt
from valvemap.model.flow_map import FlowMap
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.tensor_spline import TensorSpline

MOST_PASSES = 500


def passes_until_the_network_wins(evidence: Evidence) -> str:
    """Return the number of passes over the structured recording until the network beats RLS."""
    best = evidence.structured.rls[1.0].final
    network, samples, truth = evidence.network, evidence.data.structured, evidence.data.new
    state, error = network.initial_state(), np.inf
    for passes in range(1, MOST_PASSES + 1):
        state, _ = network.update(state, samples)
        error = error_of(network, state, truth)
        if error < best:
            return f"The RBF network beats RLS with λ = 1 after {passes} passes."
    return (
        f"Even {MOST_PASSES} passes do not let the RBF network beat RLS with λ = 1: "
        f"{error:.3g} against {best:.3g} l/min."
    )


def what_closes_the_open_points(evidence: Evidence) -> str:
    """Return the errors of maps with temperature and with hysteresis on the same recordings."""
    data = evidence.data
    warm = RecursiveLeastSquares(TensorSpline.uniform(T=(20.0, 40.0, 60.0)))
    auto = FlowMap()
    _, trace = auto.update(learnt(auto, data.hysteretic), data.hysteretic)
    left = float(np.sqrt(np.nanmean(trace.residual**2)))
    return (
        "Since then: a spline with nodes in T, learnt from 20 to 60 °C, is off by "
        f"{error_of(warm, learnt(warm, data.warm), data.hot):.3g} l/min at 60 °C; Auto, which "
        f"finds the loop by itself, leaves {left:.3g} l/min of the recording with a loop."
    )
