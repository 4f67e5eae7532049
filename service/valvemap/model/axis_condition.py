"""What has changed at an axis: each window of samples is weighed under every cause.

A reference fit has the coefficients θ₀ with the covariance P₀. Under every cause, a window's
coefficients are θ₀ + δ, and its rows are y = X·(θ₀ + δ) + e with e ~ N(0, σ²)::

    unchanged   δ ~ N(0, P)             P = P₀, slow drift, and the spline's error at corners
    a cause     δ ~ N(0, P + S·Sᵀ)      S: the directions that the cause moves, and how far

The gain of an edge moves its coefficients along θ₀; leakage moves c; air moves 1/β and the free
air; *another* moves every coefficient or none, and raises the noise. σ² has an inverse gamma
distribution about the reference's, so that a window's evidence is Student's t. With A = XᵀX/σ₀²,
Λ = P⁻¹ and r = Xᵀ(y - X·θ₀)/σ₀²::

    u = r - A·(A + Λ)⁻¹·r     K = A - A·(A + Λ)⁻¹·A     W = (1 + Sᵀ·K·S)⁻¹
    χ² = |y - X·θ₀|²/σ₀² - rᵀ·(A + Λ)⁻¹·r - uᵀ·S·W·Sᵀ·u
    log evidence = ½·log|W| - (ν + n)/2·log(1 + χ²/ν) + constant(ν, n)

Between windows a cause comes or goes at a small rate (forward algorithm of a hidden Markov model):
evidence accumulates, and a repair is seen as well. Friction is in none of these equations: it needs
the load's force.
"""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple, Self

import numpy as np

from valvemap.model.axis import KNOTS, SIZE, AxisFit, AxisState
from valvemap.model.kernels.axis_rows import COMMON, PER_LEAKAGE
from valvemap.model.samples import Floats
from valvemap.vocabulary.edges import EDGES
from valvemap.vocabulary.findings import Finding, FindingCode

CAUSES: Final = (
    FindingCode.PA_CHANGE,
    FindingCode.AT_CHANGE,
    FindingCode.PB_CHANGE,
    FindingCode.BT_CHANGE,
    FindingCode.LEAKAGE_CHANGE,
    FindingCode.AIR,
    FindingCode.MISFIT,
)
"""Of an axis; the last is *another*."""
_RATE_PER_S: Final = 1.0 / 360_000.0  # 1/s; one change in 100 h of movement
_LISTED: Final = 0.05  # least probability of a finding

_GAIN: Final = 0.1  # of an edge; sizes are prior standard deviations
_LEAKAGE: Final = 1.0  # of c
_LEAKAGE_LEAST: Final = 0.001 / PER_LEAKAGE  # 0.001 l/min/bar, where c is nearly 0
_COMPLIANCE: Final = 0.3  # of 1/β
_AIR: Final = 5.0  # %
_ANY: Final = 0.05  # of each coefficient, each for itself
_DRIFT_GAIN, _DRIFT_LEAKAGE, _DRIFT_COMPLIANCE, _DRIFT_AIR = 0.005, 0.1, 0.02, 0.05
"""What a healthy axis may differ from its reference: 5 K of oil change the leakage by 15 %."""
_CORNER: Final = 0.125  # of slope times distance: error of a parabola at a corner in its interval
_NOISE_KNOWN: Final = 10.0  # ν: degrees of freedom with which σ² is known; it varies with the work
_NOISE_OTHER: Final = 1.0  # ν under *another*
_SIZE_OF_NOTHING: Final = 1e-9  # l/min/√bar; keeps P₀ invertible


class WindowSums(NamedTuple):
    """Sums of the rows of a window: XᵀX (n, n), Xᵀy (n,), Σy², and number of rows of both lines."""

    M: Floats
    b: Floats
    yy: float
    rows: float

    @classmethod
    def of(cls, state: AxisState) -> Self:
        """Return the sums of a state."""
        M = state.M + np.tril(state.M, -1).T
        return cls(M, state.b, float(state.squares[:2].sum()), 2.0 * float(state.squares[2]))


@dataclass(frozen=True)
class Reference:
    """An axis as it was: θ₀ (n,), Λ = P⁻¹ (n, n), the rows' σ₀², and how many count as one."""

    theta: Floats
    precision: Floats
    variance: float
    together: float

    @classmethod
    def of(cls, found: AxisFit) -> Self:
        """Return the reference of a fit."""
        common = _common(found.theta, _DRIFT_LEAKAGE, 0.0, _DRIFT_COMPLIANCE, _DRIFT_AIR)
        drift = np.column_stack([_DRIFT_GAIN * _gains(found.theta), common])
        bends = [part for edge in EDGES for part in (found.bends(edge), [0.0])]
        corners = _CORNER * np.concatenate([*bends, np.zeros(COMMON)])
        P = found.covariance + drift @ drift.T + np.diag(corners**2 + _SIZE_OF_NOTHING**2)
        precision = np.asarray(np.linalg.inv(P), np.float64)
        return cls(found.theta, precision, found.residual_std**2, found.together)


class Weighed(NamedTuple):
    """A window: log evidence of *unchanged* and of each cause, (1 + C,); size and std of each."""

    log_evidence: Floats
    size: Floats
    std: Floats


_UNKNOWN: Final = Weighed(
    np.full(1 + len(CAUSES), np.nan), np.full(len(CAUSES), np.nan), np.full(len(CAUSES), np.nan)
)


def weigh(reference: Reference, window: WindowSums) -> Weighed:
    """Weigh a window of samples under every cause.

    Sizes are the relative change of an edge's flow, the leakage's change in (l/min)/bar, and % of
    free air more; NaN under *another*. Where sums are too large for numbers, all is NaN.
    """
    with np.errstate(all="ignore"):
        try:
            found = _weighed(reference, window)
        except np.linalg.LinAlgError:
            found = _UNKNOWN
    return found if np.isfinite(found.log_evidence).all() else _UNKNOWN


def _weighed(reference: Reference, window: WindowSums) -> Weighed:
    theta, scale = reference.theta, reference.variance * reference.together
    n = window.rows / reference.together
    A = window.M / scale
    r = (window.b - window.M @ theta) / scale
    squares = (window.yy - 2.0 * window.b @ theta + theta @ window.M @ theta) / scale
    solved = np.linalg.solve(A + reference.precision, np.column_stack([A, r]))
    K, u = A - A @ solved[:, :-1], r - A @ solved[:, -1]
    left = max(float(squares - r @ solved[:, -1]), 0.0)
    logs = [_student(left, n, _NOISE_KNOWN)]
    sizes, stds = [], []
    for code, S in _hypotheses(theta):
        B = np.eye(S.shape[1]) + S.T @ K @ S
        v = S.T @ u
        at = np.linalg.solve(B, v)
        less = max(left - float(v @ at), 0.0)
        if code is FindingCode.MISFIT:
            moved = _student(max(less, n), n, _NOISE_OTHER) - 0.5 * float(np.linalg.slogdet(B)[1])
            noisier = _student(max(left, n), n, _NOISE_OTHER)
            logs.append(float(np.logaddexp(moved, noisier)) - math.log(2.0))
        else:
            logs.append(_student(less, n, _NOISE_KNOWN) - 0.5 * float(np.linalg.slogdet(B)[1]))
        unit = _unit(code, theta)
        noise = max(1.0, less / max(n, 1.0))
        sizes.append(unit * float(at[0]))
        stds.append(abs(unit) * math.sqrt(noise * float(np.linalg.inv(B)[0, 0])))
    return Weighed(np.array(logs), np.array(sizes), np.array(stds))


def _student(squares: float, n: float, freedom: float) -> float:
    """Return the log evidence of n rows whose variance is known with ``freedom``."""
    return (
        math.lgamma(0.5 * (freedom + n))
        - math.lgamma(0.5 * freedom)
        - 0.5 * n * math.log(0.5 * freedom)
        - 0.5 * (freedom + n) * math.log1p(squares / freedom)
    )


def _gains(theta: Floats) -> Floats:
    """Return the directions of the four edges' gains, (n, 4)."""
    found = np.zeros((SIZE, len(EDGES)))
    for k in range(len(EDGES)):
        own = slice(k * KNOTS, (k + 1) * KNOTS)
        found[own, k] = theta[own]
    return found


def _common(theta: Floats, leakage: float, least: float, compliance: float, air: float) -> Floats:
    """Return the directions of leakage, 1/β and air, (n, 3), with these sizes."""
    found = np.zeros((SIZE, COMMON))
    at = SIZE - COMMON
    found[at + 1, 0] = math.hypot(leakage * theta[at + 1], least)
    found[at, 1] = compliance * theta[at]
    found[at + 2, 2] = air
    return found


def _hypotheses(theta: Floats) -> list[tuple[FindingCode, Floats]]:
    gains = _GAIN * _gains(theta)
    common = _common(theta, _LEAKAGE, _LEAKAGE_LEAST, _COMPLIANCE, _AIR)
    each = np.diag(_ANY * theta)[:, :-COMMON]
    return [
        *((code, gains[:, [k]]) for k, code in enumerate(CAUSES[: len(EDGES)])),
        (FindingCode.LEAKAGE_CHANGE, common[:, [0]]),
        (FindingCode.AIR, common[:, [2, 1]]),
        (FindingCode.MISFIT, np.column_stack([gains, common, each])),
    ]


def _unit(code: FindingCode, theta: Floats) -> float:
    c = float(theta[SIZE - COMMON + 1])
    if code is FindingCode.MISFIT:
        return math.nan
    if code is FindingCode.AIR:
        return _AIR
    if code is FindingCode.LEAKAGE_CHANGE:
        return math.hypot(_LEAKAGE * c, _LEAKAGE_LEAST) * PER_LEAKAGE
    return _GAIN


@dataclass(frozen=True)
class Condition:
    """Probabilities of *unchanged* and of each cause, (1 + C,), after the windows so far.

    ``size`` and ``std`` (C,) are those of :class:`Weighed`, of the newest window.
    """

    probability: Floats
    size: Floats
    std: Floats

    @classmethod
    def initial(cls) -> Self:
        """Return the condition at the reference: unchanged.

        >>> Condition.initial().unchanged, Condition.initial().findings()
        (1.0, ())
        """
        probability = np.zeros(1 + len(CAUSES))
        probability[0] = 1.0
        nothing = np.full(len(CAUSES), math.nan)
        return cls(probability, nothing, nothing)

    @property
    def unchanged(self) -> float:
        """Probability that nothing has changed."""
        return float(self.probability[0])

    def after(self, weighed: Weighed, seconds: float) -> "Condition":
        """Return the condition after a window of so many seconds; itself, if that is unknown."""
        if not np.isfinite(weighed.log_evidence).all():
            return self
        moves = -math.expm1(-seconds * _RATE_PER_S)
        others = (1.0 - self.probability) / len(CAUSES)
        before = (1.0 - moves) * self.probability + moves * others
        logs = np.log(np.maximum(before, 1e-300)) + weighed.log_evidence
        shares = np.exp(logs - logs.max())
        return Condition(shares / shares.sum(), weighed.size, weighed.std)

    def findings(self) -> tuple[Finding, ...]:
        """Return the causes that are likely enough to be listed, the likeliest first."""
        found = [
            Finding(code, float(p), _sentence(code, float(size), float(std)))
            for code, p, size, std in zip(
                CAUSES, self.probability[1:], self.size, self.std, strict=True
            )
            if p >= _LISTED
        ]
        return tuple(sorted(found, key=lambda one: -one.probability))


def _sentence(code: FindingCode, size: float, std: float) -> str:
    match code:
        case FindingCode.LEAKAGE_CHANGE:
            word = "more" if size > 0.0 else "less"
            return (
                f"Between the lines {abs(size):.2g} ± {1.96 * std:.1g} (l/min)/bar leak {word} "
                "than before."
            )
        case FindingCode.AIR:
            word = "more" if size > 0.0 else "less"
            return (
                f"The oil holds {abs(size):.2g} ± {1.96 * std:.1g} % free air {word} than before, "
                "or oil and hoses have another stiffness."
            )
        case FindingCode.MISFIT:
            return (
                "Speeds and pressures no longer fit the edges, and no single cause explains it. "
                "Check the sensors of position and pressures, play and spool."
            )
        case _:
            word = "more" if size > 0.0 else "less"
            edge = EDGES[CAUSES.index(code)]
            return (
                f"The edge {edge} passes {100.0 * abs(size):.0f} ± {196.0 * std:.1g} % {word} "
                "than before."
            )
