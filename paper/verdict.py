"""A claim of the paper, the figures it is tested by, and the verdict that follows from them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Literal, Self

import numpy as np


class Verdict(StrEnum):
    """What became of a claim."""

    REPRODUCED = "reproduced"
    EXPLAINED = "explained by an erratum"
    NOT_REPRODUCED = "not reproduced"


@dataclass(frozen=True)
class Part:
    """One figure that a claim stands or falls with.

    Attributes
    ----------
    says : str
        What the claim says, as a sentence about the figure.
    unit : str
        Of the figure; empty for a ratio or a number.
    must : {"at most", "more than"}
        On which side of the limit the figure lies where the claim holds.
    limit : float
    why : str
        The reason for the limit.
    values : (R,) float
        The figure by the right forms, of R sets of recordings; their median decides.
    printed : (R,) float
        The same by the forms as the paper prints them; none where no misprint matters.
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
        """Median of the figures; infinite if most are."""
        return _median(self.values)

    @property
    def value_as_printed(self) -> float | None:
        """Median by the printed forms."""
        return _median(self.printed) if self.printed else None

    @property
    def holds(self) -> bool:
        """Whether the claim holds here with the right forms."""
        return self._meets(self.value)

    @property
    def explained(self) -> bool:
        """Whether it holds with the printed forms alone."""
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
        Reproduced if all of them hold; explained by an erratum if those that fail hold as printed.
    note : str
        What else the figures say, beside the verdict.
    agreeing : int
        Sets of recordings whose own verdict is the same.
    """

    number: int
    text: str
    parts: tuple[Part, ...]
    note: str = ""
    agreeing: int = 1

    @property
    def verdict(self) -> Verdict:
        """What follows from the parts, and nothing else."""
        if all(part.holds for part in self.parts):
            return Verdict.REPRODUCED
        if all(part.holds or part.explained for part in self.parts):
            return Verdict.EXPLAINED
        return Verdict.NOT_REPRODUCED

    @classmethod
    def merged(cls, claims: Sequence[Self]) -> Self:
        """One claim from the same claim on several sets of recordings; the first one's note."""
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
    """The middle one, the lower of two; NaN, which meets no limit, if there is any."""
    if np.isnan(values).any():
        return float("nan")
    return sorted(values)[(len(values) - 1) // 2]
