"""What an inverse map answers."""

from dataclasses import dataclass
from enum import IntEnum

from valvemap.model.samples import Codes, Floats


class InverseStatus(IntEnum):
    """How far an inverse can be used; U is only ever given where it can."""

    OK = 0
    ABOVE_REACH = 1
    BELOW_REACH = 2
    NOT_MONOTONE = 3
    UNIDENTIFIED = 4
    NOT_FINITE = 5
    OUTSIDE = 6
    EXTRAPOLATING = 7

    @property
    def sentence(self) -> str:
        """A sentence for the operator."""
        return _INVERSE_SENTENCES[self]


_INVERSE_SENTENCES = {
    InverseStatus.OK: "U delivers the demanded flow at this pressure drop.",
    InverseStatus.ABOVE_REACH: "The valve cannot pass so much at this pressure drop; U = 100 %.",
    InverseStatus.BELOW_REACH: "Even the closed valve passes more than demanded; U = 0 %.",
    InverseStatus.NOT_MONOTONE: "The map falls with U here; no U can be trusted.",
    InverseStatus.UNIDENTIFIED: "The map is not identified here yet.",
    InverseStatus.NOT_FINITE: "The demand, the pressure drop or the temperature is not a number.",
    InverseStatus.OUTSIDE: "The pressure drop is outside the table; U is that of its nearest end.",
    InverseStatus.EXTRAPOLATING: "Nothing was measured near this U, pressure drop and temperature; "
    "U is a guess.",
}


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
