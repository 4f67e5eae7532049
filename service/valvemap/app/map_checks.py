"""The test of the maps of a replay and their inverses on samples, without updating them."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np

from valvemap.app.learnt_valve import LearntValve
from valvemap.app.recording_batches import FlowSplitting
from valvemap.model.inverse_map import invert
from valvemap.model.samples import Floats, Samples, Trace
from valvemap.pipeline import lane_predictions
from valvemap.pipeline.edges import LEAK
from valvemap.pipeline.score import Score
from valvemap.pipeline.valve_state import Lane
from valvemap.vocabulary.statuses import DELIVERS, Quality

MOST_TRIED: Final = 1_000  # samples of a batch; inverting a network costs 100 times an update
S = TypeVar("S", Samples, Floats)


@dataclass(frozen=True)
class MapCheck:
    """The test of one estimator's map and its inverse, without updating the estimator.

    ``score`` is over all samples, the other fields over the tested ones.
    """

    score: Score
    tried: int
    round_trip_max: float
    infeasible: int
    covered: int


def check_maps(valve: LearntValve, samples: Samples, *, scored: bool) -> Mapping[str, MapCheck]:
    """Test all estimators of a valve; without ``scored``, only on the thinned samples."""
    gate = valve.plan.gate
    _, judged = gate.update(gate.initial_state(), samples)
    good = judged[judged.quality != Quality.BAD]
    good = good if scored else _some(good)
    return {name: _check_lane(lane, good) for name, lane in valve.state().lanes.items()}


def verified_maps(
    valves: Mapping[str, LearntValve],
    batches: Iterable[tuple[str, Samples]],
    splitting: FlowSplitting,
) -> dict[str, list[Mapping[str, MapCheck]]]:
    """Test the maps of all valves on batches; a list of tests by valve."""
    checks: dict[str, list[Mapping[str, MapCheck]]] = {name: [] for name in valves}

    def check(name: str, samples: Samples) -> Floats:
        checks[name].append(check_maps(valves[name], samples, scored=True))
        lane = valves[name].state().lanes.get(LEAK)
        return np.empty(0) if lane is None else lane_predictions.predicted_along(lane, samples)

    for name, samples in batches:
        if name in valves:
            splitting.take(name, samples, check)
    return checks


def summed(checks: Sequence[Mapping[str, MapCheck]]) -> Mapping[str, MapCheck]:
    """Return the tests of several batches as one, by estimator."""
    names = checks[0] if checks else ()
    return {
        name: MapCheck(
            score=Score.merged([check[name].score for check in checks]),
            round_trip_max=max(check[name].round_trip_max for check in checks),
            tried=sum(check[name].tried for check in checks),
            infeasible=sum(check[name].infeasible for check in checks),
            covered=sum(check[name].covered for check in checks),
        )
        for name in names
    }


def _check_lane(lane: Lane, samples: Samples) -> MapCheck:
    estimator, state = lane.estimator, lane.state
    Q_hat = lane_predictions.predicted_along(lane, samples)
    residual = samples.Q - Q_hat
    trace = Trace(Q_hat, residual, residual, np.zeros(len(samples), np.uint8))
    tried = _some(samples)
    inverse = invert(estimator, state, tried.Q, tried.dp, tried.T)
    feasible = np.isin(inverse.status, DELIVERS)
    U, dp, T = (x[feasible] for x in (inverse.U, tried.dp, tried.T))
    Q_back, _ = estimator.predict(state, U, dp, T)
    _, half, _ = lane_predictions.predicted_measurement(lane, tried.U, tried.dp, tried.T)
    return MapCheck(
        tried=len(tried),
        covered=int((np.abs(_some(residual)) <= half).sum()),
        score=Score.none().add(samples, trace),
        round_trip_max=float(np.abs(Q_back - tried.Q[feasible]).max(initial=0.0)),
        infeasible=int((~feasible).sum()),
    )


def _some(rows: S) -> S:
    """Return at most ``MOST_TRIED`` rows, evenly spaced."""
    return rows[:: max(1, math.ceil(len(rows) / MOST_TRIED))]
