"""What has changed at an axis: each window of samples is weighed under every cause.

Two edges that change at once are one hypothesis; all others have one cause. A reference fit has the
coefficients θ₀ with the covariance P₀. Under every hypothesis, a window's
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

Here the size has its prior distribution; later, that of the windows before. Between windows a cause
comes or goes at a small rate (forward algorithm of a hidden Markov model): evidence accumulates,
and a repair is seen as well. Friction is in none of these equations, but in that of motion: its
evidence is that of *unchanged* times the factor of :mod:`~valvemap.model.axis_force`.
"""

import math
from dataclasses import dataclass
from itertools import combinations
from typing import Final, NamedTuple, Self

import numpy as np

from valvemap.model.axis import AxisState
from valvemap.model.axis_basis import COMMON, KNOTS, SIZE
from valvemap.model.axis_fit import AxisFit
from valvemap.model.axis_force import ForceReference, ForceState
from valvemap.model.kernels.axis_rows import (
    AIR,
    COMPLIANCE,
    CREEP,
    FORCE,
    LEAKAGE,
    PER_LEAKAGE,
    PLACE,
    ZERO,
)
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
    FindingCode.FRICTION,
    FindingCode.MISFIT,
)
"""Of an axis; the last is *another*."""
HYPOTHESES: Final = (
    *((code,) for code in CAUSES),
    *combinations(CAUSES[: len(EDGES)], 2),
)
"""What may have changed: each cause alone, and two edges at once."""
_FRICTION: Final = CAUSES.index(FindingCode.FRICTION)
_PAIRS: Final = slice(len(CAUSES), len(HYPOTHESES))
_TOGETHER: Final = 0.01  # of the rate of one cause: two edges at once
_RATE_PER_S: Final = 1.0 / 360_000.0  # 1/s; one change in 100 h of movement
_GROWS: Final = 0.01  # of a size's prior variance per window: damage grows
_LISTED: Final = 0.05  # least probability of a finding

_GAIN: Final = 0.1  # of an edge; sizes are prior standard deviations
_LEAKAGE: Final = 1.0  # of c
_LEAKAGE_LEAST: Final = 0.001 / PER_LEAKAGE  # 0.001 l/min/bar, where c is nearly 0
_COMPLIANCE: Final = 0.3  # of 1/β
_AIR: Final = 5.0  # %
_ANY: Final = 0.05  # of each coefficient, each for itself
_DRIFT_GAIN, _DRIFT_LEAKAGE, _DRIFT_COMPLIANCE, _DRIFT_AIR = 0.005, 0.1, 0.02, 0.05
"""What a healthy axis may differ from its reference: 5 K of oil change the leakage by 15 %."""
_DRIFT_ZERO: Final = 0.05  # mm/s; of a measured speed
_DRIFT_FORCE: Final = 1.0  # of both parts of the force: what the piston carries may change
_CORNER: Final = 0.125  # of slope times distance: error of a parabola at a corner in its interval
_NOISE_KNOWN: Final = 10.0  # ν: degrees of freedom with which σ² is known; it varies with the work
_NOISE_OTHER: Final = 1.0  # ν under *another*
_EXCLUDED: Final = -50.0  # log factor of friction, where the forces tell nothing
_SIZE_OF_NOTHING: Final = 1e-9  # l/min/√bar; keeps P₀ invertible


class WindowSums(NamedTuple):
    """Sums of the rows of a window: XᵀX (n, n), Xᵀy (n,), Σy², and number of rows of both lines.

    ``force`` are those of the balance of forces; None: there are none.
    """

    M: Floats
    b: Floats
    yy: float
    rows: float
    force: ForceState | None = None

    @classmethod
    def of(cls, state: AxisState, force: ForceState | None = None) -> Self:
        """Return the sums of a state."""
        M = state.M + np.tril(state.M, -1).T
        return cls(M, state.b, float(state.squares[:2].sum()), 2.0 * float(state.squares[2]), force)


@dataclass(frozen=True)
class Reference:
    """An axis as it was: θ₀ (n,), Λ = P⁻¹ (n, n), the rows' σ₀², and how many count as one.

    ``force`` is the balance of forces as it was; None: it is not known.
    """

    theta: Floats
    precision: Floats
    variance: float
    together: float
    force: ForceReference | None = None

    @classmethod
    def of(cls, found: AxisFit, force: ForceReference | None = None) -> Self:
        """Return the reference of a fit.

        Where the place is a range (``axis_travel``), its middle moves with the work.
        """
        common = _common(found.theta, _DRIFT_LEAKAGE, 0.0, _DRIFT_COMPLIANCE, _DRIFT_AIR)
        anywhere = found.regression.geometry.stroke_mm / math.sqrt(12.0)  # as a range: uniform
        for kind, size in (
            (ZERO, _DRIFT_ZERO),
            (PLACE, anywhere * found.theta[COMMON + COMPLIANCE]),
            (FORCE, _DRIFT_FORCE * found.theta[COMMON + FORCE]),
            (CREEP, _DRIFT_FORCE * found.theta[COMMON + CREEP]),
        ):
            common[COMMON + kind, kind] = size
        drift = np.column_stack([_DRIFT_GAIN * _gains(found.theta), common])
        bends = [part for edge in EDGES for part in (found.bends(edge), [0.0])]
        corners = _CORNER * np.concatenate([*bends, np.zeros(SIZE - COMMON)])
        P = found.covariance + drift @ drift.T + np.diag(corners**2 + _SIZE_OF_NOTHING**2)
        precision = np.asarray(np.linalg.inv(P), np.float64)
        return cls(found.theta, precision, found.residual_std**2, found.together, force)


class Weighed(NamedTuple):
    """A window: log evidence of *unchanged* and of each of H hypotheses, (1 + H,).

    ``size`` and ``std`` (H, 2) of its causes, each in its own unit; ``mean`` (H, 2) and ``spread``
    (H, 2, 2) are the same of its columns of S, in prior standard deviations.
    """

    log_evidence: Floats
    size: Floats
    std: Floats
    mean: Floats
    spread: Floats


def weigh(reference: Reference, window: WindowSums, mean: Floats, spread: Floats) -> Weighed | None:
    """Weigh a window of samples under every cause.

    Parameters
    ----------
    reference, window
        What is compared.
    mean, spread
        What is known of the sizes before, as of :class:`Weighed`.

    Returns
    -------
    Weighed or None
        Sizes are the relative change of an edge's flow, the leakage's change in (l/min)/bar, and %
        of free air more; NaN under *another*. None: the sums are too large for numbers.
    """
    with np.errstate(all="ignore"):
        try:
            found = _weighed(reference, window, mean, spread)
        except np.linalg.LinAlgError:
            return None
    are_numbers = np.isfinite(found.log_evidence).all() and np.isfinite(found.spread).all()
    return found if are_numbers else None


def _weighed(reference: Reference, window: WindowSums, mean: Floats, spread: Floats) -> Weighed:
    theta, scale = reference.theta, reference.variance * reference.together
    n = window.rows / reference.together
    A = window.M / scale
    r = (window.b - window.M @ theta) / scale
    squares = (window.yy - 2.0 * window.b @ theta + theta @ window.M @ theta) / scale
    solved = np.linalg.solve(A + reference.precision, np.column_stack([A, r]))
    K, u = A - A @ solved[:, :-1], r - A @ solved[:, -1]
    left = max(float(squares - r @ solved[:, -1]), 0.0)
    logs = [_student(left, n, _NOISE_KNOWN)]
    sizes, stds = np.full((2, len(HYPOTHESES), 2), math.nan)
    mean, spread = mean.copy(), spread.copy()
    for k, S in _columns(theta).items():
        before = np.linalg.inv(spread[k])
        after = before + S.T @ K @ S
        v = S.T @ u + before @ mean[k]
        at = np.linalg.solve(after, v)
        less = max(left - float(v @ at - mean[k] @ before @ mean[k]), 0.0)
        volume = float(np.linalg.slogdet(after)[1] - np.linalg.slogdet(before)[1])
        logs.append(_student(less, n, _NOISE_KNOWN) - 0.5 * volume)
        noise = max(1.0, less / max(n, 1.0))
        mean[k], spread[k] = at, noise * np.linalg.inv(after)
        for of, code in enumerate(HYPOTHESES[k]):
            unit = _unit(code, theta)
            sizes[k, of], stds[k, of] = unit * at[of], unit * math.sqrt(spread[k, of, of])
    factor = _EXCLUDED
    if reference.force is not None and window.force is not None:
        k = _FRICTION
        found = reference.force.weighed(window.force, float(mean[k, 0]), float(spread[k, 0, 0]))
        factor, mean[k, 0], spread[k] = found.factor, found.size, np.diag([found.variance, 1.0])
        sizes[k, 0], stds[k, 0] = found.size, math.sqrt(found.variance)
    logs.insert(1 + _FRICTION, logs[0] + factor)
    logs.insert(len(CAUSES), _another(theta, K, u, left, n))
    return Weighed(np.array(logs), sizes, stds, mean, spread)


def _another(theta: Floats, K: Floats, u: Floats, left: float, n: float) -> float:
    """Return the log evidence of *another*."""
    S = np.column_stack([*_columns(theta).values(), np.diag(_ANY * theta)[:, :COMMON]])
    S = S[:, S.any(axis=0)]
    B, v = np.eye(S.shape[1]) + S.T @ K @ S, S.T @ u
    less = max(left - float(v @ np.linalg.solve(B, v)), 0.0)
    moved = _student(max(less, n), n, _NOISE_OTHER) - 0.5 * float(np.linalg.slogdet(B)[1])
    noisier = _student(max(left, n), n, _NOISE_OTHER)
    return float(np.logaddexp(moved, noisier)) - math.log(2.0)


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
    """Return the directions of leakage, 1/β and air, (n, 7), with these sizes; the last are 0."""
    found, k = np.zeros((SIZE, SIZE - COMMON)), COMMON
    found[k + LEAKAGE, 0] = math.hypot(leakage * theta[k + LEAKAGE], least)
    found[k + COMPLIANCE, 1] = compliance * theta[k + COMPLIANCE]
    found[k + AIR, 2] = air
    return found


def _columns(theta: Floats) -> dict[int, Floats]:
    """Return S (n, 2) of each hypothesis but friction and *another*.

    A column is 0 where one is enough.
    """
    gains = _GAIN * _gains(theta)
    leakage, compliance, air, *_ = _common(theta, _LEAKAGE, _LEAKAGE_LEAST, _COMPLIANCE, _AIR).T
    nothing = np.zeros(SIZE)
    pairs = [*((gain, nothing) for gain in gains.T), (leakage, nothing), (air, compliance)]
    found = {k: np.column_stack(pair) for k, pair in enumerate(pairs)}
    both = (np.column_stack(pair) for pair in combinations(gains.T, 2))
    return found | dict(enumerate(both, start=len(CAUSES)))


def _unit(code: FindingCode, theta: Floats) -> float:
    c = float(theta[COMMON + LEAKAGE])
    if code is FindingCode.AIR:
        return _AIR
    if code is FindingCode.LEAKAGE_CHANGE:
        return math.hypot(_LEAKAGE * c, _LEAKAGE_LEAST) * PER_LEAKAGE
    return _GAIN


@dataclass(frozen=True)
class Condition:
    """Probabilities of *unchanged* and of each hypothesis, (1 + H,), after the windows so far.

    The other fields are as of :class:`Weighed`.
    """

    probability: Floats
    size: Floats
    std: Floats
    mean: Floats
    spread: Floats

    @classmethod
    def initial(cls) -> Self:
        """Return the condition at the reference: unchanged.

        >>> Condition.initial().unchanged, Condition.initial().findings()
        (1.0, ())
        """
        H = len(HYPOTHESES)
        nothing = np.full((H, 2), math.nan)
        spread = np.broadcast_to(np.eye(2), (H, 2, 2)).copy()
        return cls(np.eye(1 + H)[0], nothing, nothing, np.zeros((H, 2)), spread)

    @property
    def unchanged(self) -> float:
        """Probability that nothing has changed."""
        return float(self.probability[0])

    def after(self, reference: Reference, window: WindowSums, seconds: float) -> "Condition":
        """Return the condition after a window of so many seconds; itself, if that has no numbers.

        A cause that comes has its prior size, one that stays the size found so far: both are
        mixed by their probabilities (interacting multiple models).
        """
        moves = -math.expm1(-seconds * _RATE_PER_S)
        stays = (1.0 - moves) * self.probability
        before = stays + moves * (1.0 - self.probability) * _SHARES
        share = (stays / np.maximum(before, 1e-300))[1:, None]
        mean = share * self.mean
        apart = (share * (1.0 - share))[..., None] * self.mean[:, :, None] * self.mean[:, None, :]
        spread = share[..., None] * self.spread + (1.0 - share[..., None] + _GROWS) * np.eye(2)
        weighed = weigh(reference, window, mean, spread + apart)
        if weighed is None:
            return self
        logs = np.log(np.maximum(before, 1e-300)) + weighed.log_evidence
        shares = np.exp(logs - logs.max())
        return Condition(shares / shares.sum(), *weighed[1:])

    @property
    def of_causes(self) -> Floats:
        """Probabilities of *unchanged* and of each cause, (1 + C,); of two edges, both have it."""
        found = self.probability[: 1 + len(CAUSES)].copy()
        for pair, p in zip(HYPOTHESES[_PAIRS], self.probability[1 + len(CAUSES) :], strict=True):
            for code in pair:
                found[1 + CAUSES.index(code)] += p
        return found

    def findings(self) -> tuple[Finding, ...]:
        """Return the causes that are likely enough to be listed, the likeliest first."""
        found = []
        for code, p in zip(CAUSES, self.of_causes[1:], strict=True):
            if p >= _LISTED:
                ways = [k for k, codes in enumerate(HYPOTHESES) if code in codes]
                k = max(ways, key=lambda way: self.probability[1 + way])
                of = HYPOTHESES[k].index(code)
                size, std = float(self.size[k, of]), float(self.std[k, of])
                found.append(Finding(code, float(p), _sentence(code, size, std)))
        return tuple(sorted(found, key=lambda one: -one.probability))


_SHARES: Final = np.array(
    [1.0 / len(CAUSES) if len(one) == 1 else _TOGETHER / len(CAUSES) for one in ((), *HYPOTHESES)]
)
"""Shares of the next cause: a repair, or one of the hypotheses."""
_SHARES[0] = 1.0 / len(CAUSES)


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
        case FindingCode.FRICTION:
            word = "more" if size > 0.0 else "less"
            return (
                f"The piston has {100.0 * abs(size):.0f} ± {196.0 * std:.0f} % {word} dry friction "
                "than before."
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
