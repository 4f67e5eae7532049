"""Claims 8, 11 and 12: what the identified map is good for, and what it costs."""

import math
from dataclasses import replace
from typing import Final

import numpy as np

from service.identification import recursive_least_squares
from service.identification.inverse_map import invert
from service.identification.inversion import InverseStatus
from service.identification.model_structures import FiveTerms
from service.report.paper import operations
from service.report.paper.claims_convergence import WHY_BETTER, WHY_CONVERGED
from service.report.paper.data import exchanged
from service.report.paper.evidence import Evidence
from service.report.paper.learning import (
    EQ_7,
    INSIDE,
    LAMBDAS,
    PASSES,
    error_of_U,
    learnt,
    linear_course,
)
from service.report.paper.verdict import Claim, Part

CLOCK_HZ, SAMPLES_PER_S, SHARE = 100e6, 1e3, 0.1
SMALL_MEMORY: Final = 1024
BYTES: Final = 8


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
    truth, swapped = data.new, exchanged(data.scattered)
    inverted = invert(EQ_7, learnt(EQ_7, data.scattered), truth.Q, truth.dp, truth.T)
    other_way = replace(
        network, U_range=(0.0, network.Q_scale), Q_scale=network.U_range[1] - network.U_range[0]
    )
    polynomial = learnt(EQ_7, swapped)
    direct = {
        "eq. (7) exchanged": EQ_7.predict(polynomial, truth.Q, truth.dp, truth.T)[0],
        "RBF network exchanged": other_way.predict(
            learnt(other_way, swapped), truth.Q, truth.dp, truth.T
        )[0],
    }
    errors = {name: error_of_U(U, truth) for name, U in direct.items()}
    own = error_of_U(inverted.U, truth)
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
            f"Scattered data, U from {INSIDE[0]:g} to {INSIDE[1]:g} % (beside it Q hardly "
            f"depends on U). Root mean square error of U: inverted {own:.3g} %, "
            f"{', '.join(f'{name} {error:.3g} %' for name, error in errors.items())}."
        ),
    )
