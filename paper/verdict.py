"""A claim of the paper, the figures that test it, and the resulting verdict."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Literal, Self

import numpy as np


class Verdict(StrEnum):
    """Verdict on a claim."""

    REPRODUCED = "reproduced"
    EXPLAINED = "explained by an erratum"
    NOT_REPRODUCED = "not reproduced"


@dataclass(frozen=True)
class Part:
    """One figure that tests a claim.

    Attributes
    ----------
    says : str
        The claim, as a sentence about the figure.
    unit : str
        Unit of the figure; empty for a ratio or a number.
    must : {"at most", "more than"}
        Side of the limit on which the claim holds.
    limit : float
    why : str
        Reason for the limit.
    values : (R,) float
        The figure with the correct forms, for R sets of recordings; their median decides.
    printed : (R,) float
        The figure with the printed forms; empty if no misprint matters.
    erratum : str
        The misprinted equation.

    Examples
    --------
    >>> part = Part("it is small", "", "at most", 1.0, "so chosen", (0.5, 9.0, 0.7))
    >>> part.value, part.holds, part.explained
    (0.7, True, False)
    """

    says: str
    unit: str
    must: Literal["at most", "more than"]
    limit: float
    why: str
    values: tuple[float, ...]
    printed: tuple[float, ...] = ()
    erratum: str = ""

    @property
    def value(self) -> float:
        """Median of the figures; infinite if the majority is."""
        return _median(self.values)

    @property
    def value_as_printed(self) -> float | None:
        """Median of the figures with the printed forms."""
        return _median(self.printed) if self.printed else None

    @property
    def holds(self) -> bool:
        """Whether the claim holds with the correct forms."""
        return self._meets(self.value)

    @property
    def explained(self) -> bool:
        """Whether the claim holds only with the printed forms."""
        as_printed = self.value_as_printed
        return not self.holds and as_printed is not None and self._meets(as_printed)

    def _meets(self, value: float) -> bool:
        return value <= self.limit if self.must == "at most" else value > self.limit


@dataclass(frozen=True)
class Claim:
    """One of the paper's claims.

    Attributes
    ----------
    number : int
    text : str
        The claim.
    parts : tuple of Part
        Reproduced if all hold; explained by an erratum if those that fail hold as printed.
    note : str
        Further results, in addition to the verdict.
    agreeing : int
        Number of sets of recordings with the same verdict.
    sets : int or None
        Number of sets that it was judged on; None: all of the report's.
    """

    number: int
    text: str
    parts: tuple[Part, ...]
    note: str = ""
    agreeing: int = 1
    sets: int | None = None

    @property
    def verdict(self) -> Verdict:
        """The verdict, determined only by the parts."""
        if all(part.holds for part in self.parts):
            return Verdict.REPRODUCED
        if all(part.holds or part.explained for part in self.parts):
            return Verdict.EXPLAINED
        return Verdict.NOT_REPRODUCED

    @classmethod
    def merged(cls, claims: Sequence[Self]) -> Self:
        """Merge one claim on several sets of recordings; keep the first one's note."""
        first = claims[0]
        parts = tuple(
            replace(
                part,
                values=tuple(v for claim in claims for v in claim.parts[i].values),
                printed=tuple(v for claim in claims for v in claim.parts[i].printed),
            )
            for i, part in enumerate(first.parts)
        )
        merged = replace(first, parts=parts)
        agreeing = sum(claim.verdict == merged.verdict for claim in claims)
        return replace(merged, agreeing=agreeing)


def _median(values: tuple[float, ...]) -> float:
    """Return the lower median; NaN, which meets no limit, if any value is NaN."""
    if np.isnan(values).any():
        return float("nan")
    return sorted(values)[(len(values) - 1) // 2]
