"""Claims 8, 11 and 12: uses of the identified map, and their cost."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final, TypeVar

import numpy as np

from paper import operations
from paper.claims_convergence import WHY_BETTER, WHY_CONVERGED
from paper.data import Points, exchanged
from paper.evidence import Evidence
from paper.learning import (
    EQ_7,
    INSIDE,
    LAMBDAS,
    PASSES,
    error_of_U,
    learnt,
    linear_course,
)
from paper.verdict import Claim, Part
from valvemap.model.estimator import Estimator, State
from valvemap.model.inverse_map import invert
from valvemap.model.least_squares_of_arrays import recursive_least_squares
from valvemap.model.model_structures import FiveTerms, Polynomial
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples
from valvemap.model.tensor_spline import TensorSpline
from valvemap.vocabulary.statuses import InverseStatus

CLOCK_HZ, SAMPLES_PER_S, SHARE = 100e6, 1e3, 0.1
SMALL_MEMORY: Final = 1024
BYTES: Final = 8
FEWEST_BAR: Final = 5.0
WHY_EQUALLY_ACCURATE: Final = "'equal' is read as 10 % either way"

_INVERSE_TERMS: Final = ("1", "U", "U*s^-1", "s", "s^-1")

S = TypeVar("S", bound=State)


def claim_8(evidence: Evidence) -> Claim:
    """Eq. (7) inverts explicitly; the RBF has to be re-identified."""
    data, network = evidence.data, evidence.network
    truth = data.new
    rls = learnt(EQ_7, data.scattered)
    explicit = invert(EQ_7, rls, truth.Q, truth.dp, truth.T)
    ok = explicit.status == InverseStatus.OK
    back, _ = EQ_7.predict(rls, explicit.U[ok], truth.dp[ok], truth.T[ok])
    state = learnt(network, data.scattered, PASSES)
    searched = invert(network, state, truth.Q, truth.dp, truth.T)
    solved = searched.status == InverseStatus.OK
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
                "1e-9 of 200 l/min, the bar for every inverse of the service",
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
            f"eq. (7) {error_of_U(explicit.U, truth):.3g} %, RBF network "
            f"{error_of_U(searched.U, truth):.3g} %."
        ),
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
    truth = data.new[data.new.dp >= FEWEST_BAR]
    samples = data.scattered[data.scattered.dp >= FEWEST_BAR]
    Q_max = network.Q_scale
    network_exchanged = replace(
        network, U_range=(0.0, Q_max), Q_scale=network.U_range[1] - network.U_range[0]
    )
    inverted = {
        "eq. (7)": _error_inverted(EQ_7, samples, truth),
        "spline": _error_inverted(RecursiveLeastSquares(TensorSpline.uniform()), samples, truth),
    }
    few = {
        "eq. (7) exchanged": _error_direct(EQ_7, samples, truth),
        "terms of its inverse": _error_direct(
            RecursiveLeastSquares(Polynomial(_INVERSE_TERMS)), samples, truth
        ),
        f"RBF network, {PASSES} passes": _error_direct(network_exchanged, samples, truth, PASSES),
    }
    breaks = tuple(np.linspace(0.0, Q_max, 7).tolist())
    spline = TensorSpline(breaks, TensorSpline.uniform().s)
    many = _error_direct(RecursiveLeastSquares(spline), samples, truth)
    n = len(FiveTerms().parameter_names)
    inverse, again = operations.explicit_inverse(), operations.least_squares_step(n)
    answer = operations.linear_map(n)
    return Claim(
        12,
        "Inverting the forward map costs less than identifying U = f(Q, Δp) directly, at equal "
        "accuracy.",
        (
            Part(
                "error of U from eq. (7) inverted, over the best that few parameters identify "
                "directly",
                "",
                "at most",
                1.1,
                WHY_EQUALLY_ACCURATE,
                (inverted["eq. (7)"] / min(few.values()),),
            ),
            Part(
                "the same of a spline of 63 parameters, inverted over identified directly",
                "",
                "at most",
                1.1,
                WHY_EQUALLY_ACCURATE,
                (inverted["spline"] / many,),
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
        f"Scattered data, U from {INSIDE[0]:g} to {INSIDE[1]:g} % (beside it Q hardly depends on "
        f"U), Δp from {FEWEST_BAR:g} bar on (the terms of the inverse, with Q for U, are "
        f"{', '.join(_INVERSE_TERMS)}: small drops blow up 1/√Δp). Root mean square error "
        f"of U: inverted {_listed(inverted)}; directly {_listed({**few, 'spline': many})}.",
    )


def _error_inverted(estimator: Estimator[S], samples: Samples, truth: Points) -> float:
    state = learnt(estimator, samples)
    return error_of_U(invert(estimator, state, truth.Q, truth.dp, truth.T).U, truth)


def _error_direct(
    estimator: Estimator[S], samples: Samples, truth: Points, passes: int = 1
) -> float:
    state = learnt(estimator, exchanged(samples), passes)
    return error_of_U(estimator.predict(state, truth.Q, truth.dp, truth.T)[0], truth)


def _listed(errors: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {error:.3g} %" for name, error in errors.items())
