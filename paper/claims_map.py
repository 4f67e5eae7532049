"""Claims 7, 9 and 10: accuracy of the identified map, inside and outside of the training data."""

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from paper.claims_convergence import WHY_BETTER
from paper.data import Points, within
from paper.evidence import Evidence
from paper.learning import (
    EQ_7,
    PASSES,
    UNSETTLED,
    error_of,
    error_of_U,
    learnt,
    rmse,
)
from paper.verdict import Claim, Part
from valvemap.model.inverse_map import invert
from valvemap.model.model_structures import FiveTerms, Polynomial, Structure
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Floats, Samples
from valvemap.model.tensor_spline import TensorSpline

CORNER: Final = (70.0, 120.0)

_SPLINE: Final = RecursiveLeastSquares(TensorSpline.uniform())
_WHY_MATTERS: Final = (
    "√2: beyond it, what the map leaves out has a larger share of the mean square error than all "
    "else together"
)


def claim_7(evidence: Evidence) -> Claim:
    """RLS extrapolates better than RBF."""
    data, network = evidence.data, evidence.network
    outside = data.new[(CORNER[0] < data.new.U) | (data.new.dp > CORNER[1])]
    sorted_corner, corner = (within(x, *CORNER) for x in (data.structured, data.scattered))
    rls = [error_of(EQ_7, learnt(EQ_7, x), outside) for x in (sorted_corner, corner)]
    rbf = [
        error_of(network, learnt(network, sorted_corner), outside),
        error_of(network, learnt(network, corner, PASSES), outside),
    ]
    where = f"outside U ≤ {CORNER[0]:g} %, Δp ≤ {CORNER[1]:g} bar, where both learnt"
    return Claim(
        7,
        "RLS with eq. (7) extrapolates better than the RBF network.",
        (
            Part(
                f"error of RLS over that of the RBF network {where}; structured data",
                "",
                "at most",
                1.0,
                WHY_BETTER,
                (rls[0] / rbf[0],),
            ),
            Part(
                f"the same on scattered data, the RBF network after {PASSES} passes",
                "",
                "at most",
                1.0,
                WHY_BETTER,
                (rls[1] / rbf[1],),
            ),
        ),
        (
            f"Errors outside: RLS {rls[0]:.3g} and {rls[1]:.3g} l/min, RBF network {rbf[0]:.3g} "
            f"and {rbf[1]:.3g} l/min."
        ),
    )


def claim_9(evidence: Evidence) -> Claim:
    """Accuracy can be raised by local partitions, or by a higher order."""
    samples, truth = evidence.data.scattered, evidence.data.new
    plain = evidence.scattered.lsm_rmse
    orders = {str(k): _error(Polynomial.of_order(k), samples, truth) for k in (2, 3, 4, 5)}
    partitions = {f"{k}×{k}": _partitioned(samples, truth, k) for k in (2, 3, 4, 5)}
    return Claim(
        9,
        "The accuracy can be raised by identifying local partitions, or by a higher order of "
        "eq. (7).",
        tuple(
            Part(
                f"error of the best {name}, over that of eq. (7)",
                "",
                "at most",
                0.9,
                "a gain of less than 10 % is not worth a single further parameter",
                (min(errors.values()) / plain,),
            )
            for name, errors in (
                ("of 2×2 to 5×5 partitions", partitions),
                ("polynomial of order 2 to 5", orders),
            )
        ),
        (
            f"Scattered data; eq. (7) leaves {plain:.3g} l/min. Partitions: {_listed(partitions)}. "
            f"Orders: {_listed(orders)}; tensor spline of 63 parameters: "
            f"{_error(TensorSpline.uniform(), samples, truth):.3g} l/min."
        ),
    )


def claim_10(evidence: Evidence) -> Claim:
    """Open: temperature, hysteresis, precise motion, dynamics."""
    data = evidence.data
    spline = learnt(_SPLINE, data.scattered)
    own = _residual(data.scattered)
    eq_7 = learnt(EQ_7, data.scattered)
    answers = invert(EQ_7, eq_7, data.new.Q, data.new.dp, data.new.T)
    hot = error_of(_SPLINE, spline, data.hot)
    return Claim(
        10,
        "Open: temperature and hysteresis (4-D maps), the inverse map in precise motion control, "
        "dynamic identification.",
        (
            Part(
                "a static 3-D map at 60 °C: its error, over that at 40 °C, where it was learnt",
                "",
                "more than",
                UNSETTLED,
                _WHY_MATTERS,
                (hot / error_of(_SPLINE, spline, data.new),),
            ),
            Part(
                "of a valve with a loop of 4 %: what the map leaves, over that of the valve as new",
                "",
                "more than",
                UNSETTLED,
                _WHY_MATTERS,
                (_residual(data.hysteretic) / own,),
            ),
            Part(
                "error of U from eq. (7)'s inverse, over the loop of the valve",
                "",
                "more than",
                1.0,
                "within its own hysteresis the valve itself is no more precise",
                (error_of_U(answers.U, data.new) / data.hysteresis,),
            ),
            Part(
                "of a valve whose pilot lags by 0.1 s: what the map leaves, over that of the valve "
                "as new",
                "",
                "more than",
                UNSETTLED,
                _WHY_MATTERS,
                (_residual(data.lagging) / own,),
            ),
        ),
        "The map is a tensor spline of 63 parameters: it leaves so little that nothing hides.",
    )


def _error(structure: Structure, samples: Samples, truth: Points) -> float:
    rls = RecursiveLeastSquares(structure)
    return error_of(rls, learnt(rls, samples), truth)


def _partitioned(samples: Samples, truth: Points, k: int) -> float:
    """Return the error of eq. (7), identified separately in each of k×k parts of (U, √dp)."""
    parts, wanted = _part_of(samples, k), _part_of(truth, k)
    squares = 0.0
    for part in np.unique(wanted):
        inside = truth[wanted == part]
        squares += _error(FiveTerms(), samples[parts == part], inside) ** 2 * len(inside)
    return math.sqrt(squares / len(truth))


def _part_of(points: Samples | Points, k: int) -> Floats:
    along_U = np.clip(np.floor(points.U / 100.0 * k), 0, k - 1)
    along_s = np.clip(np.floor(np.sqrt(np.maximum(points.dp, 0.0) / 200.0) * k), 0, k - 1)
    return np.asarray(k * along_U + along_s)


def _residual(samples: Samples) -> float:
    """Return the residual of a static map fitted to the recording, l/min."""
    Q_hat, _ = _SPLINE.predict(learnt(_SPLINE, samples), samples.U, samples.dp, samples.T)
    return rmse(Q_hat, samples.Q)


def _listed(errors: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {error:.3g} l/min" for name, error in errors.items())
