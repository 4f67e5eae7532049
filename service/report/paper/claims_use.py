"""Claims 7 to 12: what the identified map is good for, and what it costs."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from service.identification import recursive_least_squares
from service.identification.inverse_map import invert
from service.identification.inversion import InverseStatus
from service.identification.model_structures import FiveTerms, Polynomial, Structure, TensorSpline
from service.identification.recursive_least_squares import RecursiveLeastSquares
from service.identification.samples import Floats, Samples
from service.report.paper import operations
from service.report.paper.claims_convergence import WHY_BETTER, WHY_CONVERGED
from service.report.paper.data import Points, exchanged, within
from service.report.paper.evidence import Evidence
from service.report.paper.learning import (
    LAMBDAS,
    UNSETTLED,
    WHY_UNSETTLED,
    error_of,
    learnt,
    linear_course,
    rmse,
)
from service.report.paper.verdict import Claim, Part

CORNER: Final = (70.0, 120.0)
PASSES: Final = 20
CLOCK_HZ, SAMPLES_PER_S, SHARE = 100e6, 1e3, 0.1
SMALL_MEMORY: Final = 1024
BYTES: Final = 8

_EQ_7: Final = RecursiveLeastSquares()
_SPLINE: Final = RecursiveLeastSquares(TensorSpline.uniform())
_INSIDE: Final = (5.0, 95.0)


def claim_7(evidence: Evidence) -> Claim:
    """RLS extrapolates better than RBF."""
    data, network = evidence.data, evidence.network
    outside = data.new[(CORNER[0] < data.new.U) | (data.new.dp > CORNER[1])]
    sorted_corner, corner = (within(x, *CORNER) for x in (data.structured, data.scattered))
    rls = [error_of(_EQ_7, learnt(_EQ_7, x), outside) for x in (sorted_corner, corner)]
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


def claim_8(evidence: Evidence) -> Claim:
    """Eq. (7) inverts explicitly; the RBF has to be re-identified."""
    data, network = evidence.data, evidence.network
    truth = data.new
    rls = learnt(_EQ_7, data.scattered)
    explicit = invert(_EQ_7, rls, truth.Q, truth.dp, truth.T)
    ok = explicit.status == InverseStatus.OK
    back, _ = _EQ_7.predict(rls, explicit.U[ok], truth.dp[ok], truth.T[ok])
    state = learnt(network, data.scattered, PASSES)
    searched = invert(network, state, truth.Q, truth.dp, truth.T)
    solved = searched.status <= InverseStatus.BELOW_REACH
    return Claim(
        8,
        "Eq. (7) inverts explicitly; the RBF network has to be identified again with inputs and "
        "output exchanged.",
        (
            Part(
                "largest |Q(U(Q, Δp), Δp) − Q| of eq. (7)'s explicit inverse",
                "l/min",
                "at most",
                2e-7,
                "1e-9 of 200 l/min, a thousand times the rounding",
                (float(np.abs(back - truth.Q[ok]).max(initial=0.0)) if ok.any() else math.inf,),
            ),
            Part(
                "share of flows that a search in the RBF network's forward map gives no U for",
                "",
                "more than",
                0.05,
                "a search that answers 19 of 20 flows spares the second identification",
                (float(1.0 - solved.mean()),),
            ),
        ),
        (
            f"The network after {PASSES} passes over scattered data. Root mean square error of U: "
            f"eq. (7) {_error_of_U(explicit.U, truth):.3g} %, RBF network "
            f"{_error_of_U(searched.U, truth):.3g} %."
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
    eq_7 = learnt(_EQ_7, data.scattered)
    answers = invert(_EQ_7, eq_7, data.new.Q, data.new.dp, data.new.T)
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
                f"the temperature matters from {WHY_UNSETTLED}",
                (hot / error_of(_SPLINE, spline, data.new),),
            ),
            Part(
                "of a valve with a loop of 4 %: what the map leaves, over that of the valve as new",
                "",
                "more than",
                UNSETTLED,
                f"hysteresis matters from {WHY_UNSETTLED}",
                (_residual(data.hysteretic) / own,),
            ),
            Part(
                "error of U from eq. (7)'s inverse, over the loop of the valve",
                "",
                "more than",
                1.0,
                "within its own hysteresis the valve itself is no more precise",
                (_error_of_U(answers.U, data.new) / data.hysteresis,),
            ),
            Part(
                "of a valve whose pilot lags by 0.1 s: what the map leaves, over that of the valve "
                "as new",
                "",
                "more than",
                UNSETTLED,
                f"dynamics matter from {WHY_UNSETTLED}",
                (_residual(data.lagging) / own,),
            ),
        ),
        "The map is a tensor spline of 63 parameters: it leaves so little that nothing hides.",
    )


def claim_11(evidence: Evidence) -> Claim:
    """RLS handles all data types with little memory; RBF is too costly for embedded systems."""
    data, structure = evidence.data, FiveTerms()
    n = len(structure.parameter_names)
    X = structure.regressors(data.cycle.U, data.cycle.dp, data.cycle.T)
    XV = structure.regressors(data.working.U, data.working.dp, data.working.T)
    histories = {
        lam: recursive_least_squares(X, data.cycle.Q, lam).theta_history for lam in LAMBDAS
    }
    unrest = {
        lam: max(
            evidence.structured.rls[lam].unrest,
            evidence.scattered.rls[lam].unrest,
            linear_course(histories[lam], XV, data.working.Q).unrest,
        )
        for lam in LAMBDAS
        if lam < 1.0
    }
    best = min(unrest, key=lambda lam: unrest[lam])
    numbers = n + n * n
    budget = SHARE * CLOCK_HZ / SAMPLES_PER_S
    rls, rbf = operations.least_squares_step(n), operations.network_step(evidence.network)
    neurons = evidence.network.grid[0] * evidence.network.grid[1]
    return Claim(
        11,
        "RLS handles all data types with little memory; the RBF network is too costly for "
        "embedded systems.",
        (
            Part(
                "with one λ < 1, RLS converges on structured, scattered and working-cycle data",
                "",
                "at most",
                1.0,
                WHY_CONVERGED,
                (unrest[best],),
            ),
            Part(
                "memory of RLS: θ and P in double precision",
                "bytes",
                "at most",
                SMALL_MEMORY,
                "half of the memory that the smallest controllers have, 2 KiB",
                (float(BYTES * numbers),),
            ),
            Part(
                f"cycles of one step of the RBF network with {neurons} neurons",
                "",
                "more than",
                budget,
                "10 % of a controller of 100 MHz at 1,000 samples/s, one cycle per operation and "
                "100 per exp",
                (float(rbf.cycles),),
            ),
        ),
        (
            f"The λ is {best:g}. One step of RLS takes {rls.plain} operations, of the network "
            f"{rbf.plain} and {rbf.exponentials} exp: {rbf.cycles / rls.cycles:.0f} times the "
            f"cycles. It would be too costly from {math.ceil(budget / rbf.cycles * neurons)} "
            "neurons on. The paper does not tell the size of its network."
        ),
    )


def claim_12(evidence: Evidence) -> Claim:
    """Inverting the forward map costs less than identifying U = f(Q, dp), at equal accuracy."""
    data, network = evidence.data, evidence.network
    truth, swapped = data.new, exchanged(data.scattered)
    inverted = invert(_EQ_7, learnt(_EQ_7, data.scattered), truth.Q, truth.dp, truth.T)
    other_way = replace(
        network, U_range=(0.0, network.Q_scale), Q_scale=network.U_range[1] - network.U_range[0]
    )
    polynomial = learnt(_EQ_7, swapped)
    direct = {
        "eq. (7) exchanged": _EQ_7.predict(polynomial, truth.Q, truth.dp, truth.T)[0],
        "RBF network exchanged": other_way.predict(
            learnt(other_way, swapped), truth.Q, truth.dp, truth.T
        )[0],
    }
    errors = {name: _error_of_U(U, truth) for name, U in direct.items()}
    own = _error_of_U(inverted.U, truth)
    n = len(FiveTerms().parameter_names)
    inverse, again = operations.explicit_inverse(), operations.least_squares_step(n)
    answer = operations.linear_map(n)
    return Claim(
        12,
        "Inverting the forward map costs less than identifying U = f(Q, Δp) directly, at equal "
        "accuracy.",
        (
            Part(
                "error of U from the inverted map, over the best of those identified directly",
                "",
                "at most",
                1.1,
                "'equal' is read as 10 % either way",
                (own / min(errors.values()),),
            ),
            Part(
                "operations per sample and answer beside the forward map: inverting, over "
                "identifying again",
                "",
                "at most",
                1.0,
                WHY_BETTER,
                (inverse.cycles / (again.cycles + answer.cycles),),
            ),
        ),
        (
            f"Scattered data, U from {_INSIDE[0]:g} to {_INSIDE[1]:g} % (beside it Q hardly "
            f"depends on U). Root mean square error of U: inverted {own:.3g} %, "
            f"{', '.join(f'{name} {error:.3g} %' for name, error in errors.items())}."
        ),
    )


def _error(structure: Structure, samples: Samples, truth: Points) -> float:
    rls = RecursiveLeastSquares(structure)
    return error_of(rls, learnt(rls, samples), truth)


def _partitioned(samples: Samples, truth: Points, k: int) -> float:
    """Error of eq. (7) identified in each of k×k equal parts of (U, √dp) by itself."""
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
    """What a static map of its own leaves of a recording, l/min."""
    Q_hat, _ = _SPLINE.predict(learnt(_SPLINE, samples), samples.U, samples.dp, samples.T)
    return rmse(Q_hat, samples.Q)


def _error_of_U(U: Floats, truth: Points) -> float:
    """Root mean square error of U, %, away from the ends, where U has no effect on Q."""
    inside = (_INSIDE[0] <= truth.U) & (_INSIDE[1] >= truth.U) & np.isfinite(U)
    return rmse(U[inside], truth.U[inside]) if inside.any() else math.inf


def _listed(errors: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {error:.3g} l/min" for name, error in errors.items())
