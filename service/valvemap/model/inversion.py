"""Answers of an inverse map: the control voltage of a demanded flow, with interval and status."""

from dataclasses import dataclass

import numpy as np

from valvemap.model.samples import Codes, Floats
from valvemap.vocabulary.statuses import InverseStatus


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

    def __repr__(self) -> str:
        """Return all fields, statuses by name."""
        names = np.array([InverseStatus(int(code)).name for code in self.status.flat])
        shown = names.reshape(self.status.shape).tolist()
        return (
            f"Inversion(U={self.U!r}, lower={self.lower!r}, upper={self.upper!r}, status={shown})"
        )
