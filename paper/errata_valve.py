"""Errata of the valve's equations and of its structure, eqs. (1)-(7)."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from paper.data import IdealValve, PaperData
from paper.erratum import ROUNDING, Erratum
from valvemap.model.inverse_map import invert
from valvemap.model.model_structures import FiveTerms
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Floats, Samples
from valvemap.vocabulary.statuses import InverseStatus

Mask = NDArray[np.bool_]
LARGEST_U = 100.0


def of_the_valve(data: PaperData) -> Iterator[Erratum]:
    """Evaluate all errata of eqs. (1) to (7)."""
    valve = data.ideal
    lifted = valve.x_MP > 0.0
    yield _stroke(valve, lifted)
    yield _gain(valve, lifted)
    yield _pilot(valve, lifted)
    yield _seat(valve, lifted)
    yield from _structure(data)


def _stroke(valve: IdealValve, lifted: Mask) -> Erratum:
    share = valve.phi / ((valve.phi - 1.0) * valve.dp)
    right = valve.Q_PV / valve.K_c * np.sqrt(share) - valve.x_0
    printed = valve.Q_PV / valve.K_c * np.sqrt((valve.phi - 1.0) / (valve.phi * valve.dp)) - (
        valve.x_0
    )
    return Erratum(
        "(3)",
        "x_MP = Q_PV/K_c · √((φ−1)/(φ·Δp)) − x₀",
        "x_MP = Q_PV/K_c · √(φ/((φ−1)·Δp)) − x₀",
        "largest error of the stroke, over the stroke, against the solved balance of forces and "
        f"flows of an ideal valve, φ = {valve.phi:g}",
        _largest((printed - valve.x_MP)[lifted] / valve.x_MP[lifted]),
        _largest((right - valve.x_MP)[lifted] / valve.x_MP[lifted]),
        *ROUNDING,
    )


def _gain(valve: IdealValve, lifted: Mask) -> Erratum:
    Q_MP = (valve.Q - valve.Q_PV)[lifted]
    lost = valve.K_MP * valve.x_0 * np.sqrt(valve.dp[lifted])
    gain, phi = valve.K_MP / valve.K_c, valve.phi
    printed = gain * np.sqrt((phi - 1.0) / phi) * valve.Q_PV[lifted]
    right = gain * np.sqrt(phi / (phi - 1.0)) * valve.Q_PV[lifted] - lost
    return Erratum(
        "(5)",
        "Q_MP = K_MP/K_c · √((φ−1)/φ) · Q_PV",
        "Q_MP = K_MP/K_c · √(φ/(φ−1)) · Q_PV − K_MP·x₀·√Δp",
        "largest error of the main flow, over the flow, against the same solved balance",
        _largest((printed - Q_MP) / Q_MP),
        _largest((right - Q_MP) / Q_MP),
        *ROUNDING,
    )


def _pilot(valve: IdealValve, lifted: Mask) -> Erratum:
    x_PV, dp, Q = valve.x_PV[lifted], valve.dp[lifted], valve.Q[lifted]
    amplified = 1.0 + valve.K_MP / valve.K_c * np.sqrt(valve.phi / (valve.phi - 1.0))
    Q_PV = valve.K_PV * x_PV * np.sqrt(dp / valve.phi)
    right = amplified * Q_PV - valve.K_MP * valve.x_0 * np.sqrt(dp)
    # Without the pilot's equation Q_PV is an independent signal: its value at the median drop.
    fixed = valve.K_PV * x_PV * np.sqrt(np.median(dp) / valve.phi)
    printed = amplified * fixed - valve.K_MP * valve.x_0 * np.sqrt(dp)
    return Erratum(
        "pilot stage",
        "missing: Q_PV is given, whatever Δp is",
        "p_c − p₂ = Δp/φ and Q_PV = K_PV·x_PV·√(Δp/φ), so Q_T ∝ √Δp",
        "largest error of the total flow, over the flow, of the ideal valve from 20 to 180 bar",
        _largest((printed - Q) / Q),
        _largest((right - Q) / Q),
        *ROUNDING,
    )


def _seat(valve: IdealValve, lifted: Mask) -> Erratum:
    closed = ~lifted
    dp, Q = valve.dp[closed], valve.Q[closed]
    # On the seat (3) would give a negative stroke; slot and pilot are in series.
    formula = valve.K_PV * valve.x_PV[closed] / (valve.K_c * np.sqrt(valve.phi - 1.0)) - valve.x_0
    Q_PV = valve.K_PV * valve.x_PV[closed] * np.sqrt(dp / valve.phi)
    printed = Q_PV + valve.K_MP * formula * np.sqrt(dp)
    slot, pilot = valve.K_c * valve.x_0, valve.K_PV * valve.x_PV[closed]
    right = np.sqrt(dp) * slot * pilot / np.hypot(slot, pilot)
    return Erratum(
        "(1), (3), (5) on the seat",
        "used for any signal: at small ones the stroke is negative",
        "x_MP = 0: K_c·x₀ and the pilot are in series",
        "largest error of the flow, over the flow, of the ideal valve before the poppet lifts",
        _largest((printed - Q) / Q),
        _largest((right - Q) / Q),
        *ROUNDING,
    )


def _structure(data: PaperData) -> Iterator[Erratum]:
    samples, structure = data.structured, FiveTerms()
    level = samples[np.abs(samples.U - data.levels[len(data.levels) // 2]) < 1.0]
    n = len(structure.parameter_names)
    yield Erratum(
        "(7), within one level",
        "no condition on the data",
        "U is constant within a level, three of five columns are left: it takes several levels",
        f"{n} minus the rank of the regressors: of one level, and of all",
        float(n - _rank(structure, level)),
        float(n - _rank(structure, samples)),
        0.0,
        "full rank",
    )
    yield _singular()
    both = np.array([25.0, 100.0, 196.0])
    s, theta = np.sqrt(both), np.array([0.3, -0.05])
    forward, backward = theta[0] * s + theta[1] * s**2, theta[0] * -s + theta[1] * s**2
    rows = structure.regressors(np.zeros(3), -both, both)[:, [2, 4]]
    yield Erratum(
        "(7), a₅",
        "a₅·(√Δp)² , with √Δp = sign(Δp)·√|Δp| where Δp < 0",
        "a₅·s·|s|: the flow turns round with Δp",
        "largest |Q(−Δp) + Q(Δp)| at U = 0 with a₃ = 0.3, a₅ = −0.05, l/min",
        _largest(forward + backward),
        _largest(forward + rows @ theta),
        *ROUNDING,
    )


def _singular() -> Erratum:
    """Evaluate a map that decreases with U below s = -a2/a4, as noisy data may give."""
    theta = np.array([0.0, -0.7, 0.0, 0.1, 0.0])  # a2 + a4·s = 0 at 49 bar
    U, dp = (x.ravel() for x in np.meshgrid([10.0, 50.0, 90.0], [16.0, 100.0, 196.0]))
    Q = FiveTerms().regressors(U, dp, dp) @ theta
    rls = RecursiveLeastSquares()
    state, _ = rls.update(rls.initial_state(), Samples.of(np.arange(9), U, dp, 0 * dp, Q))
    near = np.array([36.0, 48.9, 49.0, 49.1])
    demand = np.full(4, 50.0)
    s = np.sqrt(near)
    with np.errstate(all="ignore"):
        printed = (demand - theta[0] - theta[2] * s - theta[4] * s**2) / (theta[1] + theta[3] * s)
    answer = invert(rls, state, demand, near, np.full(4, 40.0))
    given = np.where(answer.status == InverseStatus.OK, answer.U, 0.0)
    return Erratum(
        "(7), inverted",
        "U = (Q − a₁ − a₃s − a₅s²)/(a₂ + a₄s), everywhere",
        "only where ∂Q/∂U = a₂ + a₄s > 0; elsewhere a status, never a number",
        "largest |U| that is answered as if it could be set, %, around the zero of a₂ + a₄s",
        float(np.max(np.abs(printed))),
        float(np.max(np.abs(given))),
        LARGEST_U,
        "U ends at 100 %",
    )


def _rank(structure: FiveTerms, samples: Samples) -> int:
    X = structure.regressors(samples.U, samples.dp, samples.T)
    return int(np.linalg.matrix_rank(X / np.linalg.norm(X, axis=0)))


def _largest(errors: Floats) -> float:
    return float(np.max(np.abs(errors), initial=0.0))
