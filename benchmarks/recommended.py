"""Whether the recommended estimator is the best: ``python -m benchmarks.recommended --seeds N``.

Estimators run side by side through the pipeline. A line per circumstance and seed: which one is
recommended, its regret, the regret of the estimator with the least one-step error, and the best.
*Regret* is the error of the chosen map over that of the best map, inside the data and with the
noise σ of one measurement added to both: √(e² + σ²)/√(e_best² + σ²) - 1. The last lines: regrets,
how often each estimator is best, and for each estimator the mean share of true flows inside its
95 % interval, as it comes from the estimator and as it is published, and the share of samples in
the second half at status OK. ``--report`` takes the seeds that nothing is tuned on. ``--only
recorded`` measures the recordings of docs/accuracy.md alone.
"""

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks import circumstances as c
from benchmarks import one_model_rows as rows
from benchmarks import results_file
from benchmarks.accuracy import MAPS
from benchmarks.measured_data import air_valve, cooling_circuit, elsewhere_is_there
from benchmarks.recordings import (
    COOLING_CIRCUIT,
    SETTLED,
    air_valve_error,
    air_valve_swept,
    r2,
)
from valvemap.model.estimator import Estimator
from valvemap.model.flow_map import FlowMap
from valvemap.model.forgetting import Adaptive, Exponential
from valvemap.model.maximum_likelihood import MaximumLikelihood
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples, Segments, Trace
from valvemap.pipeline.fleet import Fleet
from valvemap.pipeline.lane_predictions import predicted
from valvemap.pipeline.quality_gate import QualityGate
from valvemap.pipeline.valve_state import ValvePlan
from valvemap.vocabulary.statuses import Status

RESULTS: Final = Path(__file__).parent / "results" / "recommended.json"
REPORT: Final = 41_000  # the first seed of those that nothing is tuned on
N, BATCH = 20_000, 4_096  # samples
YOUNG, VARIETIES, MOVING = 3_000, 8, 0.9  # samples, valves, coefficient of the noise
LEVELS, HELD = 11, 400  # levels of a staircase, samples at each

PAPER: Final[dict[str, Estimator[Any]]] = {
    "RLS": RecursiveLeastSquares(forgetting=Adaptive()),
    "RML": MaximumLikelihood(nd=1, lam=0.999),
    "RBF": RbfNetwork(),
}
ALL: Final = {**PAPER, "Auto": FlowMap()}
FOLLOWING: Final = {
    "RLS .95": RecursiveLeastSquares(forgetting=Exponential(0.95)),
    "RLS 1": RecursiveLeastSquares(forgetting=Exponential(1.0)),
    "RBF": RbfNetwork(),
}

Circumstance = tuple[dict[str, Estimator[Any]], Callable[[int], rows.Row]]


def staircase(name: str, seed: int) -> rows.Row:
    """U held at levels in random order, dp swept at each."""
    rng, valve = np.random.default_rng(seed), c.VALVES[name]
    levels = np.concatenate([rng.permutation(np.linspace(0.0, 100.0, LEVELS)) for _ in range(5)])
    U = np.repeat(levels, HELD)[:N]
    dp = 95.0 + 90.0 * np.sin(np.arange(N) * 2.0 * np.pi / 173.0)
    return rows.Row(c.samples_of(U, dp, valve(U, dp) + c.white(seed, N)), (N,), (valve,))


def sweep(name: str, seed: int) -> rows.Row:
    """U and dp swept slowly: from sample to sample the flow hardly changes."""
    valve, t = c.VALVES[name], np.arange(N) / c.FS
    U = 50.0 + 49.0 * np.sin(2.0 * np.pi * t / 41.0 + seed)
    dp = 100.0 + 90.0 * np.sin(2.0 * np.pi * t / 7.3 + 2.0 * seed)
    return rows.Row(c.samples_of(U, dp, valve(U, dp) + c.white(seed, N)), (N,), (valve,))


def coloured(number: int, seed: int) -> rows.Row:
    """Eq. (7) with other parameters, scattered, noise of a moving average: RML's model."""
    rng = np.random.default_rng([number, seed])
    valve = c.eq7_of(c.THETA * rng.uniform(0.6, 1.4, len(c.THETA)))
    U, dp = c.scattered(seed, YOUNG)
    white = rng.normal(0.0, c.SIGMA, YOUNG + 1)
    Q = valve(U, dp) + white[1:] + MOVING * white[:-1]
    return rows.Row(c.samples_of(U, dp, Q), (YOUNG,), (valve,))


def _circumstances() -> dict[str, Circumstance]:
    found: dict[str, Circumstance] = {}
    for name in rows.SIX:
        for kind in ("scattered", "cycle"):
            found[f"{name}, {kind}"] = ALL, partial(rows.plain, name, kind, N)
            found[f"{name}, {kind}, paper's three"] = PAPER, partial(rows.plain, name, kind, N)
        young = partial(rows.plain, name, "scattered", YOUNG)
        found[f"{name}, young, paper's three"] = PAPER, young
        found[f"{name}, staircase"] = ALL, partial(staircase, name)
        found[f"{name}, sweep, followers"] = FOLLOWING, partial(sweep, name)
        found[f"{name}, AR(.95)"] = ALL, partial(rows.coloured, name, N)
        found[f"{name}, spikes"] = ALL, partial(rows.spiked, name, "cycle", N)
    for name in ("ordinary", "eq. (7)"):
        found[f"{name}, -15 %/h"] = ALL, partial(rows.fading, name, 10)
    for number in range(VARIETIES):
        found[f"eq. (7) no. {number}, MA(.9), paper's three"] = PAPER, partial(coloured, number)
    found["knee"] = ALL, partial(rows.knee, "cycle", N)
    return found


def measured(estimators: dict[str, Estimator[Any]], row: rows.Row) -> dict[str, Any]:
    """Run the estimators; return each one's error, shares held and OK, and the recommended one."""
    plan = ValvePlan("V", QualityGate(), estimators, next(iter(estimators)), follows=True)
    fleet, end, one = Fleet(plan, 1), row.ends[-1], {name: [] for name in estimators}
    statuses: dict[str, list[np.ndarray]] = {name: [] for name in estimators}
    for start in range(0, end, BATCH):
        samples = row.samples[start : min(start + BATCH, end)]
        _, traces = fleet.take(samples, Segments.one(len(samples)))
        for name, trace in traces.items():
            one[name].append(trace.residual)
            statuses[name].append(trace.status)
    ranking, found = fleet.maps.rank_now(0), {}
    at = rows.inside(row, end)
    T, truth = np.full(len(at.U), row.T), row.truths[-1](at.U, at.dp)
    for name in estimators:
        lane = fleet.lane(0, name)
        Q, std, _ = predicted(lane, at.U, at.dp, T)
        own = lane.estimator.predict(lane.state, at.U, at.dp, T)[1]
        known = np.isfinite(Q)
        error = np.abs(Q - truth)
        found[name] = {
            "rmse": c.rms(error[known]) if known.mean() > 0.5 else np.inf,
            "one_step": float(np.sqrt(np.nanmean(np.concatenate(one[name]) ** 2))),
            "own": float(np.mean(error <= c.TWO_SIDED_95 * own)),
            "held": float(np.mean(error <= c.TWO_SIDED_95 * std)),
            "ok": float(np.mean(np.concatenate(statuses[name])[end // 2 :] == Status.OK)),
        }
    names = list(estimators)
    return {
        "estimators": found,
        "recommended": names[ranking.chosen] if ranking.chosen >= 0 else "",
        "sure": ranking.sure,
    }


def regret(found: dict[str, Any], chosen: str) -> float:
    """Error of the chosen map over that of the best one, with the noise of one measurement."""
    of = {name: float(np.hypot(f["rmse"], c.SIGMA)) for name, f in found["estimators"].items()}
    return of[chosen] / min(of.values()) - 1.0


def _line(name: str, seed: int, found: dict[str, Any]) -> tuple[str, float, float, float]:
    errors = {e: f["rmse"] for e, f in found["estimators"].items()}
    steps = {e: f["one_step"] for e, f in found["estimators"].items()}
    best, followed = (min(of, key=lambda e, of=of: of[e]) for of in (errors, steps))
    chosen = found["recommended"]
    ours = regret(found, chosen) if chosen else np.nan
    by_step = regret(found, followed)
    print(
        f"{name} [{seed}]: {chosen or 'none'} ({found['sure']:.2f} sure), regret {ours:.3f}; "
        f"by one-step error {followed}, {by_step:.3f}; best {best}, {errors[best]:.3f} l/min",
        flush=True,
    )
    return best, ours, by_step, errors[chosen] / errors[best] if chosen else np.nan


def recorded() -> None:
    """Recordings of docs/accuracy.md: which estimator is recommended, and the error of each."""
    estimators = {"RLS .999": RecursiveLeastSquares(COOLING_CIRCUIT, Exponential(0.999)), **ALL}
    samples = cooling_circuit()
    chosen, traces = _recommended(estimators, samples)
    scores = {}
    for name, trace in traces.items():
        known = np.isfinite(trace.residual)
        known[:SETTLED] = False
        scores[name] = round(r2(samples.Q[known], trace.residual[known]), 5)
    print(f"cooling circuit: recommended {chosen}; R² one step ahead {scores}", flush=True)
    if elsewhere_is_there():
        valve = air_valve()
        chosen, _ = _recommended(MAPS, air_valve_swept(valve))
        scores = {name: round(air_valve_error(valve, MAPS[name]).rmse, 3) for name in MAPS}
        print(f"air valve: recommended {chosen}; RMSE in l/min {scores}", flush=True)


def _recommended(
    estimators: Mapping[str, Estimator[Any]], samples: Samples
) -> tuple[str, Mapping[str, Trace]]:
    plan = ValvePlan("V", QualityGate(), dict(estimators), "Auto", follows=True)
    fleet = Fleet(plan, 1)
    _, traces = fleet.take(samples, Segments.one(len(samples)))
    ranking = fleet.maps.rank_now(0)
    return list(estimators)[ranking.chosen] if ranking.chosen >= 0 else "none", traces


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--only", default="")
    parser.add_argument("--report", action="store_true", help="seeds that nothing is tuned on")
    wanted = parser.parse_args(arguments)
    first = REPORT if wanted.report else 0
    every, lines = [], []
    for name, (estimators, make) in _circumstances().items():
        if wanted.only not in name:
            continue
        for seed in range(first, first + wanted.seeds):
            found = measured(estimators, make(seed))
            every.append((name, found))
            lines.append(_line(name, seed, found))
    if every:
        _summary(every, lines)
    if wanted.only in ("", "recorded"):
        recorded()
    return 0


def _summary(
    every: list[tuple[str, dict[str, Any]]], lines: list[tuple[str, float, float, float]]
) -> None:
    best, ours, by_step, ratios = (np.array(x) for x in zip(*lines, strict=True))
    given = np.isfinite(ours)
    shares = {str(name): round(float(np.mean(best == name)), 2) for name in np.unique(best)}
    figures: dict[str, Any] = {
        "regret": float(ours[given].mean()),
        "regret_largest": float(ours[given].max()),
        "regret_at_most_0.1": float(np.mean(ours[given] <= 0.1)),
        "none_recommended": float(np.mean(~given)),
        "regret_by_one_step_error": float(by_step.mean()),
        "ratio_of_maps": float(np.exp(np.mean(np.log(ratios[given])))),
        "best": shares,
    }
    print(
        f"regret {figures['regret']:.3f}, at most .1 in {figures['regret_at_most_0.1']:.2f}, "
        f"largest {figures['regret_largest']:.3f}; none recommended "
        f"{figures['none_recommended']:.2f}; by one-step error {by_step.mean():.3f}; geometric "
        f"mean of maps' errors over the best {figures['ratio_of_maps']:.2f}; best: {shares}"
    )
    for name in dict.fromkeys(e for _, found in every for e in found["estimators"]):
        plain = [
            found["estimators"][name]
            for circumstance, found in every
            if name in found["estimators"] and circumstance.endswith(("scattered", "cycle"))
        ]
        if plain:
            own, held, ok = (float(np.mean([f[k] for f in plain])) for k in ("own", "held", "ok"))
            figures[name] = {"own": own, "held": held, "ok": ok}
            print(
                f"{name} on six valves: {own:.3f} inside its own interval, {held:.3f} inside the "
                f"published one, OK {ok:.3f}"
            )
    kept = json.loads(RESULTS.read_text("utf-8")) if RESULTS.exists() else {}
    results_file.keep(RESULTS, {**kept, "recommended": figures})


if __name__ == "__main__":
    sys.exit(main())
