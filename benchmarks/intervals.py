"""How many new measurements of the virtual rig lie within their 95 % intervals.

``python -m benchmarks.intervals [SEEDS]`` asks each estimator for the interval half a second ahead,
all along three recordings, and prints the share within and the interval's mean width over that of
±1.96·RMSE.
"""

import sys
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from benchmarks.measured_data import Floats
from valvemap.model.estimator import Estimator
from valvemap.model.flow_map import FlowMap
from valvemap.model.forgetting import Adaptive, Exponential
from valvemap.model.maximum_likelihood import MaximumLikelihood
from valvemap.model.model_structures import FiveTerms
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples
from valvemap.model.tensor_spline import TensorSpline
from valvemap.pipeline.lane_predictions import predicted_measurement
from valvemap.pipeline.valve_state import Lane, fresh_lane
from valvemap_rig.excitation import Cycle, Excitation, Scattered, Structured
from valvemap_rig.scenario import Scenario
from valvemap_rig.simulation import advance, initial

RATE_HZ, AHEAD, LEARNT = 50.0, 25, 500
SPLINE: Final = TensorSpline.uniform(6, 4)
ESTIMATORS: Final[Mapping[str, Estimator[Any]]] = {
    "RLS, λ = 1": RecursiveLeastSquares(FiveTerms(), Exponential(1.0)),
    "RLS, λ = .99": RecursiveLeastSquares(FiveTerms(), Exponential(0.99)),
    "RLS, default": RecursiveLeastSquares(FiveTerms(), Adaptive()),
    "RML, default": MaximumLikelihood(lam=0.999),
    "RBF": RbfNetwork(),
    "spline, λ = 1": RecursiveLeastSquares(SPLINE, Exponential(1.0)),
    "spline, default": RecursiveLeastSquares(SPLINE, Adaptive()),
    "Auto": FlowMap(),
}
EXCITATIONS: Final[Mapping[str, tuple[Excitation, int]]] = {
    "scattered": (Scattered(), 6_000),
    "structured": (Structured(), 11_000),
    "cycle": (Cycle(), 6_000),
}


def recording(excitation: Excitation, n: int, seed: int) -> Samples:
    """N samples of the rig as new."""
    scenario = Scenario(seed=seed, sample_rate_hz=RATE_HZ, excitation=excitation)
    _, block = advance(scenario, initial(scenario, start_ns=0), n)
    v = block.valves["Valvistor"]
    return Samples.of(v.t, v.U, v.p1, v.p2, v.Q, v.T)


def asked(estimator: Estimator[Any], samples: Samples, ahead: int = AHEAD) -> tuple[Floats, Floats]:
    """Errors of the predictions and half the intervals, both (M,), asked before each batch.

    Where an interval is not known yet it is NaN, and is left out.
    """
    lane: Lane = fresh_lane(estimator)
    errors, halves = [], []
    for start in range(0, len(samples), ahead):
        batch = samples[start : start + ahead]
        if start >= LEARNT:
            Q, half, _ = predicted_measurement(lane, batch.U, batch.dp, batch.T)
            errors.append(batch.Q - Q)
            halves.append(half)
        state, trace = estimator.update(lane.state, batch)
        spread, support = lane.spread.add(batch, trace), lane.support.add(batch, trace)
        lane = Lane(estimator, state, lane.score, spread, support)
    error, half = np.concatenate(errors), np.concatenate(halves)
    known = np.isfinite(error) & np.isfinite(half)
    return error[known], half[known]


def coverage(name: str, excitation: str, seeds: int, ahead: int = AHEAD) -> tuple[float, float]:
    """Share of the measurements within, pooled over seeds; width over that of ±1.96·RMSE."""
    pairs = [
        asked(ESTIMATORS[name], recording(*EXCITATIONS[excitation], seed), ahead)
        for seed in range(seeds)
    ]
    errors, halves = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    width = np.mean(halves) / (1.96 * np.sqrt(np.mean(errors**2)))
    return float(np.mean(np.abs(errors) <= halves)), float(width)


def main() -> None:
    """Print a line per recording and estimator."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    print(f"{'':12}{'':18}{'within':>8}{'width':>8}")
    for excitation in EXCITATIONS:
        for name in ESTIMATORS:
            within, width = coverage(name, excitation, seeds)
            print(f"{excitation:12}{name:18}{within:8.3f}{width:8.2f}", flush=True)


if __name__ == "__main__":
    main()
