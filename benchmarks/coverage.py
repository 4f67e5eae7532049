"""How often the 95 % interval holds the true flow inside the data, and how wide it is.

Cells of `benchmarks.honest_maps`: default RLS and RML where eq. (7) is exact, and `Auto`, on a
machine's cycle of 300 s. The *oracle* is generalised least squares of the same structure, with the
noise's correlation known, and with the λ, the weight of the structure's prior and, of a spline, the
knots that are best in hindsight; its width is 3.92 times the RMS of its true error, pooled over the
seeds.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np

from benchmarks import circumstances as c
from benchmarks.cells import Cell, Figures, Judged
from valvemap.model.estimator import Estimator
from valvemap.model.flow_map import FlowMap
from valvemap.model.forgetting import Adaptive
from valvemap.model.maximum_likelihood import MaximumLikelihood
from valvemap.model.model_structures import FiveTerms, Structure, StructureWithPrior
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.tensor_spline import TensorSpline
from valvemap.vocabulary.statuses import Adaptation

N: Final = 30_000  # samples
RHO: Final = 0.95
MEMORIES: Final = (300.0, 1_000.0, 3_000.0, 10_000.0, 30_000.0, np.inf)  # samples of the oracle
PRIORS: Final = (1e-6, 1e-4, 1e-2, 1.0, 100.0)  # times the structure's own prior
SPLINES: Final = tuple(TensorSpline.uniform(n, 6) for n in (6, 12, 20))  # of the oracle
KINDS: Final = ("ideal", "AR(.95)", "drift", "closed loop", "reacting")
LEAST, MOST = 0.90, 0.98
WIDEST: Final = {"drift": 2.5}  # times the oracle, and 1.5 elsewhere
RLS, RML, AUTO = (
    RecursiveLeastSquares(forgetting=Adaptive()),
    MaximumLikelihood(lam=0.999),
    FlowMap(),
)
PAIRS: Final[Sequence[tuple[str, Estimator[Any], str]]] = (
    ("RLS", RLS, "eq. (7)"),
    ("RML", RML, "eq. (7)"),
    ("Auto", AUTO, "eq. (7)"),
    ("Auto", AUTO, "ordinary"),
    ("Auto", AUTO, "saturating"),
)


@dataclass(frozen=True)
class Stream:
    """U, dp and Q of a circumstance, the valve as new and at their end, the noise's correlation."""

    U: np.ndarray
    dp: np.ndarray
    Q: np.ndarray
    valve: c.Valve
    now: c.Valve
    rho: float = 0.0


def stream(kind: str, valve: c.Valve, seed: int) -> Stream:
    """N samples at 100 Hz."""
    U, dp = c.cycle(seed, N)
    white = c.white(seed, N)
    match kind:
        case "AR(.95)":
            return Stream(U, dp, valve(U, dp) + c.ar(seed, N, RHO), valve, valve, RHO)
        case "drift":
            factor = c.drift(N)
            now = partial(_scaled, valve, factor[-1])
            return Stream(U, dp, valve(U, dp) * factor + white, valve, now)
        case "closed loop":
            U, dp, Q = c.closed_loop(seed, N, valve)
            return Stream(U, dp, Q, valve, valve)
        case "reacting":
            U = c.reacting(U, white)
    return Stream(U, dp, valve(U, dp) + white, valve, valve)


def one(estimator: Estimator[Any], kind: str, valve: c.Valve, seed: int) -> Figures:
    """Points asked and held; mean width; squared error; errors of oracles, l/min."""
    of = stream(kind, valve, seed)
    state, trace = estimator.update(estimator.initial_state(), c.samples_of(of.U, of.dp, of.Q))
    at = c.inside(of.U, of.dp)
    Q, std = estimator.predict(state, at.U, at.dp, at.T)
    truth = of.now(at.U, at.dp)
    structures = (FiveTerms(),) if valve is c.VALVES["eq. (7)"] else SPLINES
    return {
        "points": len(Q),
        "held": int(np.sum(np.abs(Q - truth) <= c.TWO_SIDED_95 * std)),
        "width": float(np.mean(2.0 * c.TWO_SIDED_95 * std)),
        "square": float(np.mean((Q - truth) ** 2)),
        "oracles": [x for one in structures for x in _oracles(of, one, at, truth)],
        "status": int(trace.status[-1]),
        "reacts": float(_reacts(estimator, state)),
    }


def judge(kind: str, found: Sequence[Figures]) -> Judged:
    """Coverage with its standard error over seeds, width over the oracle's."""
    held, points = (np.array([f[k] for f in found]) for k in ("held", "points"))
    share = held.sum() / points.sum()
    of_seeds = held / points
    error = float(np.std(of_seeds, ddof=1) / np.sqrt(len(found))) if len(found) > 1 else np.nan
    oracle = np.sqrt(np.mean(np.square([f["oracles"] for f in found]), axis=0).min())
    width = np.mean([f["width"] for f in found]) / (2.0 * c.TWO_SIDED_95 * oracle)
    rmse = np.sqrt(np.mean([f["square"] for f in found])) / c.SIGMA
    told = np.mean([f["reacts"] for f in found])
    most = WIDEST.get(kind, 1.5)
    says = told >= 0.95
    good = LEAST <= share <= MOST and width <= most
    text = f"{share:.3f} ± {error:.3f}, width {width:.2f} × oracle, RMSE {rmse:.2f} σ"
    if kind == "reacting" or told > 0.0:
        text += f", said to react {told:.2f}"
    return Judged(text, f".90-.98, ≤ {most} ×", good or (kind == "reacting" and says))


def cells() -> Mapping[str, Cell]:
    """A cell per kind, estimator and valve; forty seeds each."""
    return {
        f"{kind}, {name} on {valve}": Cell(
            40, partial(one, estimator, kind, c.VALVES[valve]), partial(judge, kind)
        )
        for kind in KINDS
        for name, estimator, valve in PAIRS
    }


def _scaled(valve: c.Valve, factor: float, U: np.ndarray, dp: np.ndarray) -> np.ndarray:
    return factor * valve(U, dp)


def _reacts(estimator: Estimator[Any], state: Any) -> bool:
    return estimator.adaptation(state) == Adaptation.REACTING


def _oracles(of: Stream, structure: Structure, at: c.Region, truth: np.ndarray) -> list[float]:
    """RMS of its error at the points asked, by memory and weight of the prior."""
    T = np.full(len(of.U), 40.0)
    X, Q = structure.regressors(of.U, of.dp, T), of.Q
    if of.rho:
        X, Q = X[1:] - of.rho * X[:-1], Q[1:] - of.rho * Q[:-1]
    asked = structure.regressors(at.U, at.dp, at.T)
    errors, smooth = [], np.zeros((X.shape[1], X.shape[1]))
    if isinstance(structure, StructureWithPrior):
        rows, _ = structure.prior()
        smooth = rows.T @ rows
    for memory in MEMORIES if of.now is not of.valve else MEMORIES[-1:]:
        weight = np.exp((np.arange(len(Q)) - len(Q)) / memory)
        information, of_Q = X.T @ (weight[:, None] * X), X.T @ (weight * Q)
        for weight_of_prior in PRIORS if smooth.any() else PRIORS[:1]:
            theta = np.linalg.lstsq(information + weight_of_prior * smooth, of_Q)[0]
            errors.append(c.rms(asked @ theta - truth))
    return errors
