"""Answers of an inverse map."""

from dataclasses import dataclass

from valvemap.model.samples import Codes, Floats


@dataclass(frozen=True)
class Inversion:
    """Answers of U = f(Q, dp[, T]) at N points, all arrays of shape (N,).

    Attributes
    ----------
    U : float64
        Control voltage, %; within [0, 100], at the nearer end out of reach; a guess where the
        status is EXTRAPOLATING; NaN where it is NOT_MONOTONE, UNIDENTIFIED or NOT_FINITE.
    lower, upper : float64
        95 % interval of U, % (clipped to [0, 100]); NaN where unknown.
    status : uint8
        :class:`InverseStatus`.
    """

    U: Floats
    lower: Floats
    upper: Floats
    status: Codes
