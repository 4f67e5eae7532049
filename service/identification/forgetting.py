"""How recursive least squares lets go of the past: one frozen dataclass per rule.

All rules share one step, eq. (28) as corrected: L = P·X/(λ + XᵀPX), theta += L·(Q - Xᵀtheta). They
differ in what becomes of the information P⁻¹; r means XᵀPX.
"""

from dataclasses import dataclass, replace
from typing import assert_never


@dataclass(frozen=True)
class Exponential:
    """P⁻¹ ← λP⁻¹ + X·Xᵀ, eqs. (26)-(28): weights λ^(N-i); λ = 1 is eq. (25).

    Where nothing excites a direction, P would grow there for ever: far beyond any use it is held,
    and λ forgets along X alone (status UNEXCITED).
    """

    lam: float = 1.0

    def __post_init__(self) -> None:
        _check_lam(self.lam)


@dataclass(frozen=True)
class Directional:
    """P⁻¹ ← P⁻¹ + (1 - (1 - λ)/r)·X·Xᵀ: forgets along X alone; what is not excited is kept.

    Kulhavý: Restricted exponential forgetting in real-time identification, Automatica 23 (1987).
    For one parameter it is exponential forgetting.
    """

    lam: float = 0.99

    def __post_init__(self) -> None:
        _check_lam(self.lam)


Forgetting = Exponential | Directional


def with_lam(forgetting: Forgetting, lam: float) -> Forgetting:
    """Use the same rule with another λ, 0 < λ ≤ 1.

    Raises
    ------
    ValueError
        if λ is out of range.

    Examples
    --------
    >>> with_lam(Exponential(0.99), 0.995)
    Exponential(lam=0.995)
    """
    match forgetting:
        case Exponential() | Directional():
            return replace(forgetting, lam=lam)
        case _:
            assert_never(forgetting)


def _check_lam(lam: float) -> None:
    if not 0.0 < lam <= 1.0:
        raise ValueError(f"forgetting factor lam = {lam!r} is not in (0, 1]")
