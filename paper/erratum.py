"""A misprint, compared with the correct form."""

from dataclasses import dataclass
from typing import Final

ROUNDING: Final = (1e-6, "an identity: nothing but rounding may be left")


@dataclass(frozen=True)
class Erratum:
    """One misprint of the paper.

    Attributes
    ----------
    equation : str
    printed, right : str
        Both forms.
    measure : str
        The error measure of both forms; smaller is better.
    printed_error, right_error : float
    limit : float
    why : str
        Reason for the limit.

    Examples
    --------
    >>> Erratum("(0)", "1 + 1 = 3", "1 + 1 = 2", "error", 1.0, 0.0, 0.5, "half").shown
    True
    """

    equation: str
    printed: str
    right: str
    measure: str
    printed_error: float
    right_error: float
    limit: float
    why: str

    @property
    def right_holds(self) -> bool:
        """Whether the correct form is within the limit."""
        return self.right_error <= self.limit

    @property
    def printed_fails(self) -> bool:
        """Whether the printed form exceeds the limit; non-finite errors do."""
        return not self.printed_error <= self.limit

    @property
    def shown(self) -> bool:
        """Whether the errors confirm the misprint."""
        return self.right_holds and self.printed_fails
