"""A sheet's figures beside a datasheet and its tolerances, and its curve beside another map."""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from valvemap.model.samples import Floats
from valvemap.model.sheet import Figure, Measured, Sheet


class Verdict(StrEnum):
    """What tolerances make of a figure: decided only where its interval is on one side."""

    PASS = "pass"  # noqa: S105 - no password
    FAIL = "fail"
    UNDECIDED = "undecided"


@dataclass(frozen=True)
class Line:
    """A figure, the datasheet's value of it, the verdict, and its tolerances.

    None, or an infinite tolerance, where nothing is expected.
    """

    figure: Figure
    datasheet: float | None = None
    verdict: Verdict | None = None
    least: float = -math.inf
    most: float = math.inf


@dataclass(frozen=True)
class Apart:
    """Flow of the sheet's curve less that of another map at the rated Δp, l/min: mean, largest.

    ``Q`` is the other map's flow along the curve, (G,).
    """

    name: str
    mean: float
    largest: float
    at_U: float
    Q: Floats


def judge(figure: Figure, least: float, most: float) -> Verdict:
    """Compare a figure with tolerances.

    >>> one = Figure("leakage", "", "leakage", "l/min", "", Measured.MEASURED, 1.0, 0.9, 1.1)
    >>> [str(judge(one, 0.0, most)) for most in (2.0, 1.0, 0.5)]
    ['pass', 'undecided', 'fail']
    """
    if figure.measured is not Measured.MEASURED:
        return Verdict.UNDECIDED
    if least <= figure.lower and figure.upper <= most:
        return Verdict.PASS
    if figure.upper < least or figure.lower > most:
        return Verdict.FAIL
    return Verdict.UNDECIDED


def compare(sheet: Sheet, name: str, Q: Floats) -> Apart | None:
    """Compare the curve with the flows (G,) of another map; None where both know no flow."""
    fit = sheet.fit
    both = fit.known & np.isfinite(Q)
    if not both.any():
        return None
    apart = np.where(both, fit.Q - Q, 0.0)
    at = int(np.argmax(np.abs(apart)))
    return Apart(name, float(apart[both].mean()), float(apart[at]), float(fit.x[at]), Q)
