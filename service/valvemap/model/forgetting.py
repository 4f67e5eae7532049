"""Forgetting rules of recursive least squares: one frozen dataclass per rule.

All rules share eq. (23), theta(t) = theta(t-1) + P(t)·X(t)·(Q(t) - Xᵀ(t)·theta(t-1)). They differ
in the update of the information P⁻¹; r denotes XᵀPX, `lam` the forgetting factor λ, 0 < λ ≤ 1.

A memory of 1/(1 - λ) samples must hold as many samples as parameters estimated from it, see
`least_lam`: below, P is singular and theta follows the noise of single samples.
"""

from dataclasses import dataclass, replace
from typing import assert_never


@dataclass(frozen=True)
class Exponential:
    """P⁻¹ ← λP⁻¹ + X·Xᵀ, eqs. (26)-(28): weights λ^(N-i); λ = 1 is eq. (25).

    Without excitation of a direction, P would grow there without bound. Beyond a limit it is held,
    and λ is applied along X only (status UNEXCITED).
    """

    lam: float = 1.0

    def __post_init__(self) -> None:
        _check_factor("lam", self.lam)


@dataclass(frozen=True)
class Variable:
    """Exponential; large innovations lower λ(t) = 1 - (1 - λ)·e²/((1 + r)·σ²) ≥ `least`.

    Fortescue, Kershenbaum, Ydstie: Implementation of self-tuning regulators with variable
    forgetting factors, Automatica 17 (1981).
    """

    lam: float = 0.999
    least: float = 0.9

    def __post_init__(self) -> None:
        _check_factor("lam", self.lam)
        _check_factor("least", self.least)


@dataclass(frozen=True)
class Resetting:
    """Exponential, with a small information added to each parameter in turn.

    P⁻¹ decays to `information` of one sample (in the columns' scales) about each parameter
    instead of to 0, so that P is bounded. Salgado, Goodwin, Middleton: Modified least
    squares algorithm incorporating exponential resetting and forgetting, Int. J. Control 47 (1988);
    cyclic as in Lai, Bernstein: Exponential resetting and cyclic resetting RLS, L-CSS 7 (2023).
    """

    lam: float = 0.99
    information: float = 0.01

    def __post_init__(self) -> None:
        _check_factor("lam", self.lam)
        if not 0.0 < self.information < float("inf"):
            raise ValueError(f"information = {self.information!r} is not positive and finite")


@dataclass(frozen=True)
class Directional:
    """P⁻¹ ← P⁻¹ + (1 - (1 - λ)/r)·X·Xᵀ: forgets along X only, keeps unexcited directions.

    Kulhavý: Restricted exponential forgetting in real-time identification, Automatica 23 (1987).
    For one parameter it is exponential forgetting.
    """

    lam: float = 0.99

    def __post_init__(self) -> None:
        _check_factor("lam", self.lam)


@dataclass(frozen=True)
class Subspace:
    """P⁻¹ ← P⁻¹ - (1 - λ)·P⁻¹XXᵀP⁻¹/(XᵀP⁻¹X) + X·Xᵀ, X in the columns' scales.

    Cao, Schwartz: A directional forgetting algorithm based on the decomposition of the information
    matrix, Automatica 36 (2000); for several outputs SIFt-RLS, arXiv 2404.10844.
    """

    lam: float = 0.99

    def __post_init__(self) -> None:
        _check_factor("lam", self.lam)


@dataclass(frozen=True)
class SlidingWindow:
    """The last `length` samples with weight 1, all earlier ones with weight 0."""

    length: int = 500

    def __post_init__(self) -> None:
        if not 1 <= self.length <= 1_000_000:
            raise ValueError(f"length = {self.length!r} is not in 1 … 1 000 000 samples")

    @property
    def lam(self) -> float:
        """λ of an equivalent exponential memory."""
        return 1.0 - 1.0 / self.length


@dataclass(frozen=True)
class Adaptive:
    """No forgetting until the flow at revisited places changes: the default.

    A memory of places (:mod:`valvemap.model.kernels.places`) separates structural misfit, which
    repeats at the same place, from drift, which depends on time. Misfit causes no adaptation. If
    places drift, theta is refitted to the last measurement of each place, weighted by age; no place
    is dropped. An abrupt change is detected in the part of the residuals that is new
    (:mod:`valvemap.model.kernels.change_detection`). All earlier samples then get the weight of a
    tenth of a sample, so that new samples replace them quickly.

    With `lam` < 1 the plant is known to drift: `Subspace` is applied to one sample of eight with
    λ⁸, and faster while innovations are coloured. Misfit would then be taken for drift.

    Attributes
    ----------
    lam : float
        1, or λ of a plant that is known to drift.
    least : float
        Smallest λ.
    threshold : float
        Threshold of the change scores, in standard deviations.
    """

    lam: float = 1.0
    least: float = 0.96
    threshold: float = 6.3

    def __post_init__(self) -> None:
        _check_factor("lam", self.lam)
        _check_factor("least", self.least)
        if not self.threshold > 0.0:
            raise ValueError(f"threshold = {self.threshold!r} is not positive")


Forgetting = Exponential | Variable | Resetting | Directional | Subspace | SlidingWindow | Adaptive


def with_lam(forgetting: Forgetting, lam: float) -> Forgetting:
    """Return the same rule with another λ.

    Raises
    ------
    ValueError
        if λ is not in (0, 1], or the rule has none.

    Examples
    --------
    >>> with_lam(Exponential(0.99), 0.995)
    Exponential(lam=0.995)
    """
    match forgetting:
        case SlidingWindow():
            raise ValueError("a sliding window has a length and no forgetting factor")
        case Exponential() | Variable() | Resetting() | Directional() | Subspace() | Adaptive():
            return replace(forgetting, lam=lam)
        case _:
            assert_never(forgetting)


def least_lam(forgetting: Forgetting, n: int) -> float:
    """Return the smallest λ for theta (n,), the parameters that one sample depends on.

    `Exponential`, `Variable` and `Adaptive` forget in all directions at each sample: theta (n,) and
    σ² are estimated from one memory, 1/(1 - λ) ≥ n + 1. `Directional` and `Subspace` forget along X
    only, and `Resetting` keeps information about each parameter: each direction has a separate
    memory, from which its parameter and σ² are estimated, 1/(1 - λ) ≥ 2.

    Raises
    ------
    ValueError
        if the rule has none.

    Examples
    --------
    >>> least_lam(Exponential(), 4), least_lam(Directional(), 4)
    (0.8, 0.5)
    """
    match forgetting:
        case Exponential() | Variable() | Adaptive():
            return lam_of_memory(n + 1)
        case Directional() | Subspace() | Resetting():
            return lam_of_memory(2)
        case SlidingWindow():
            raise ValueError("a sliding window has a length and no forgetting factor")
        case _:
            assert_never(forgetting)


def lam_of_memory(samples: int) -> float:
    """Return λ whose memory 1/(1 - λ) is ``samples``."""
    return 1.0 - 1.0 / samples


def check_lam(lam: float, least: float) -> None:
    """Check a forgetting factor.

    Raises
    ------
    ValueError
        if λ is not in [least, 1].
    """
    if least <= lam <= 1.0:
        return
    samples = round(1.0 / (1.0 - least))
    raise ValueError(
        f"forgetting factor {lam!r}: allowed is {least:.4g} <= lam <= 1, a memory "
        f"1/(1 - lam) of at least {samples} samples, as many as there are unknowns"
    )


def _check_factor(name: str, value: float) -> None:
    if not 0.0 < value <= 1.0:
        raise ValueError(f"forgetting factor {name} = {value!r} is not in (0, 1]")
