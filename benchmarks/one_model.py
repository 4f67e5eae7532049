"""`Auto`, row by row: ``python -m benchmarks.one_model --seeds N [--only ROW]``.

A line per row and moment: RMSE of the map inside the data in σ, the share of true flows inside the
95 % interval, and the least such share over the quarters of U and of Δp; each the mean over the
seeds, RMSE the root mean square. *Named* is the share of the causes found, *names too many* the
number of others, *play off* the error of its width, *delay* the number of samples of more than 5 %
of the largest flow from a change until it was found. *Answered* is the share of the true flows
inside the data for which the inverse gives U at status OK, *wrong* the share of these answers at
which the valve passes a flow that is more than 3 σ off. ``--report`` takes the seeds that nothing
is tuned on.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from benchmarks import circumstances as c
from benchmarks.one_model_oil import OILS
from benchmarks.one_model_rows import ROWS, Flow, Row, inside
from benchmarks.one_model_sensors import SENSORS
from valvemap.model.estimator import Estimator
from valvemap.model.flow_map import FlowMap
from valvemap.model.flow_map_state import FlowMapState
from valvemap.model.inverse_map import invert
from valvemap.vocabulary.statuses import InverseStatus

WRONG: Final = 3.0  # σ; more is a wrong answer, less is no demand
REPORT: Final = 97_000  # the first seed of those that nothing is tuned on

Figures = dict[str, list[float]]


def measured(estimator: Estimator[Any], row: Row) -> Figures:
    """Error, share held, least share of a quarter, after each of the row's moments; µs a sample."""
    state, start, spent = estimator.initial_state(), 0, 0.0
    found: Figures = {"rmse": [], "held": [], "least": [], "width": [], "us": []}
    found |= {"named": [], "misnamed": [], "play off": [], "delay": []}
    found |= {"answered": [], "wrong": []}
    for end, truth in zip(row.ends, row.truths, strict=True):
        began = time.process_time()
        state, _ = estimator.update(state, row.samples[start:end])
        spent, start = spent + time.process_time() - began, end
        at = inside(row, end)
        asked = truth(at.U, at.dp) < row.below
        at = c.Region(at.U[asked], at.dp[asked])
        Q, std = estimator.predict(state, at.U, at.dp, np.full(len(at.U), row.T))
        error = Q - truth(at.U, at.dp)
        held = np.abs(error) <= c.TWO_SIDED_95 * std  # a flow that is not known is not held
        error, std = (x[np.isfinite(Q)] for x in (error, std))
        found["rmse"].append(c.rms(error) / row.sigma)
        found["held"].append(float(held.mean()))
        found["least"].append(min(held[q].mean() for x in (at.U, at.dp) for q in quarters(x)))
        found["width"].append(c.rms(std) / row.sigma)
        found["us"].append(1e6 * spent / end)
        if isinstance(estimator, FlowMap):
            codes = {one.code for one in estimator.findings(state)}
            found["named"].append(len(codes & row.causes) / max(len(row.causes), 1))
            found["misnamed"].append(float(len(codes - row.causes)))
            found["play off"].append(abs(2.0 * estimator.half_play(state) - row.play))
            found["delay"].append(_delay(estimator, state, row))
        answered, wrong = answers(estimator, state, row, truth, at)
        found["answered"].append(answered)
        found["wrong"].append(wrong)
    return found


def answers(
    estimator: Estimator[Any], state: Any, row: Row, truth: Flow, at: c.Region
) -> tuple[float, float]:
    """Share of the true flows that are answered; of these answers, the share that is wrong."""
    demand = truth(at.U, at.dp)
    asked = np.abs(demand) > WRONG * row.sigma
    demand, dp = demand[asked], at.dp[asked]
    answer = invert(estimator, state, demand, dp, np.full(len(dp), row.T))
    good = answer.status == InverseStatus.OK
    off = np.abs(truth(answer.U[good], dp[good]) - demand[good]) > WRONG * row.sigma
    return float(good.mean()), float(off.mean()) if good.any() else 0.0


def _delay(estimator: FlowMap, state: FlowMapState, row: Row) -> float:
    """Samples of a flow that tells something from the change until it was found."""
    change = estimator.last_change(state)
    if row.changed < 0 or change is None or change.sample < row.changed:
        return np.nan
    Q = np.abs(row.samples.Q)
    return float(np.count_nonzero(Q[row.changed : change.sample] > 0.05 * Q.max()))


def quarters(x):
    low, high = x.min(), x.max()
    place = np.minimum((4.0 * (x - low) / max(high - low, 1e-9)).astype(int), 3)
    return [place == k for k in range(4) if (place == k).any()]


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--only", default="")
    parser.add_argument("--report", action="store_true", help="seeds that nothing is tuned on")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    wanted = parser.parse_args(arguments)
    first = REPORT if wanted.report else wanted.first
    rows = {**ROWS, **SENSORS, **OILS}
    for name in (name for name in rows if wanted.only in name):
        seeds = range(first, first + wanted.seeds)
        ours = [measured(_ours(rows[name](seed)), rows[name](seed)) for seed in seeds]
        for k in range(len(ours[0]["rmse"])):
            print(_line(name, k, ours), flush=True)
    return 0


def _ours(row: Row) -> FlowMap:
    return FlowMap(U_range=row.U_range, dp_range=row.dp_range)


def _line(name: str, k: int, ours: Sequence[Figures]) -> str:
    one = _at(ours, k)
    text = (
        f"{name} [{k}]: {c.rms(one['rmse']):.3f} σ, held {one['held'].mean():.3f} "
        f"(a quarter {one['least'].mean():.3f}), std {one['width'].mean():.3f} σ, "
        f"{one['us'].mean():.1f} µs, named {one['named'].mean():.2f}, "
        f"names too many {one['misnamed'].mean():.2f}, answered {one['answered'].mean():.3f}, "
        f"wrong {one['wrong'].mean():.4f}"
    )
    for what, unit in (("play off", "%"), ("delay", "samples")):
        if np.isfinite(one[what]).any():
            text += f", {what} {np.nanmean(one[what]):.2f} {unit}"
    return text


def _at(found: Sequence[Figures], k: int) -> dict[str, np.ndarray]:
    """Figures of all seeds at the k-th moment."""
    return {key: np.array([f[key][k] for f in found]) for key in found[0] if found[0][key]}


if __name__ == "__main__":
    sys.exit(main())
