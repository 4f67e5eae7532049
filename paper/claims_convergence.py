"""Claims 1 to 6 and 13: convergence by method and data, and tracking after a damage."""

import math
from collections.abc import Iterator

from paper.evidence import Evidence
from paper.learning import (
    LAMBDAS,
    PAPERS,
    UNSETTLED,
    Course,
    Lessons,
    settling,
)
from paper.verdict import Claim, Part

WHY_CONVERGED = (
    "1 is the border of convergence: beyond it a map cannot tell neighbouring levels of U apart "
    "(10 l/min) or fluctuates by more than its own error (√2 times its median)"
)
WHY_BETTER = "above 1 it is the other way round"
WHY_MUCH = "'much' is read as three times"
WHY_SLOWER = "a fifth more is the least that a plot of the run would show"
WHY_SAME_ACCURACY = "a difference of 5 % cannot be seen in the paper's 45° plots"
WHY_EQUAL = "far above rounding, far below anything that matters"
WHY_FOLLOWS = (
    "√2: beyond it, what is left of the old valve has a larger share of the mean square error than "
    "the map's own misfit"
)

PIECES = 10


def claim_1(evidence: Evidence) -> Claim:
    """Structured: RLS with λ = 0.995 does not converge, a larger λ does, λ = 1 is LSM."""
    known = evidence.structured
    between = {lam: known.rls[lam] for lam in LAMBDAS if PAPERS < lam < 1.0}
    best = min(between, key=lambda lam: between[lam].unrest)
    least_squares = known.theta[1.0][-1]
    difference = max(abs(least_squares - known.lsm) / abs(known.lsm))
    converging = [f"{lam:g}" for lam in LAMBDAS if known.rls[lam].converged]
    return Claim(
        1,
        "Structured data: RLS with λ = 0.995 does not converge; a larger λ does; λ = 1 equals LSM "
        "and suffers from data saturation.",
        (
            Part(
                "RLS with λ = 0.995 is far from convergence",
                "",
                "more than",
                1.0,
                WHY_CONVERGED,
                (known.rls[PAPERS].unrest,),
                (known.rls[PAPERS**2].unrest,),
                "(28)",
            ),
            Part(
                "RLS with some λ between 0.995 and 1 converges",
                "",
                "at most",
                1.0,
                WHY_CONVERGED,
                (between[best].unrest,),
            ),
            Part(
                "parameters of λ = 1 differ from LSM, eq. (16), by no more than rounding",
                "",
                "at most",
                1e-8,
                WHY_EQUAL,
                (float(difference),),
            ),
            Part(
                "data saturation: error of λ = 1 after a damage, over that of a fresh start",
                "",
                "more than",
                UNSETTLED,
                WHY_FOLLOWS,
                (evidence.damage.end(1.0),),
            ),
        ),
        f"λ that converge on structured data: {', '.join(converging) or 'none'}.",
    )


def claim_2(evidence: Evidence) -> Claim:
    """Structured: RBF fits best at the end, converges slowly."""
    known = evidence.structured
    best = min(course.final for lam, course in known.rls.items() if lam in LAMBDAS)
    return Claim(
        2,
        "Structured data: the RBF network fits best at the end, but converges slowly.",
        (
            Part(
                "error of the RBF network at the end, over that of RLS with its best λ",
                "",
                "at most",
                1.0,
                WHY_BETTER,
                (known.rbf.final / best,),
                (known.rbf_printed.final / best,),
                "(37)",
            ),
            Part(
                "samples until the RBF network settles, over those of RLS with λ = 1",
                "",
                "more than",
                1.0,
                "at 1 it is as fast",
                (_ratio(known.rbf.settled_after, known.rls[1.0].settled_after),),
            ),
        ),
        "Every method sees every sample once.",
    )


def claim_3(evidence: Evidence) -> Claim:
    """Structured: RML does not converge."""
    return Claim(
        3,
        "Structured data: RML does not converge.",
        (
            Part(
                "RML is far from convergence",
                "",
                "more than",
                1.0,
                WHY_CONVERGED,
                (evidence.structured.rml.unrest,),
                (evidence.structured.rml_printed.unrest,),
                "(29)",
            ),
        ),
        (
            f"Error at the end: RML {evidence.structured.rml.final:.3g} l/min, as printed "
            f"{evidence.structured.rml_printed.final:.3g}, RLS with λ = 1 "
            f"{evidence.structured.rls[1.0].final:.3g}."
        ),
    )


def claim_4(evidence: Evidence) -> Claim:
    """Scattered: a wider range of λ, and everything converges much faster."""
    structured, scattered = evidence.structured, evidence.scattered
    return Claim(
        4,
        "Scattered data: RLS converges for a wider range of λ; and all methods converge much "
        "faster than on structured data.",
        (
            Part(
                "largest 1 − λ that converges on scattered data, over that on structured data",
                "",
                "more than",
                1.0,
                "at 1 the range is as wide",
                (_ratio(_widest(scattered), _widest(structured)),),
            ),
            *(
                Part(
                    f"samples until {name} settles: structured over scattered data",
                    "",
                    "more than",
                    3.0,
                    WHY_MUCH,
                    (_ratio(slow.settled_after, fast.settled_after),),
                )
                for name, slow, fast in _pairs(structured, scattered)
            ),
        ),
        (
            f"Smallest λ that converges: {1 - _widest(scattered):g} on scattered, "
            f"{1 - _widest(structured):g} on structured data."
        ),
    )


def claim_5(evidence: Evidence) -> Claim:
    """Scattered: RML ends as accurate as RLS, converges more slowly."""
    rml, rls = evidence.scattered.rml, evidence.scattered.rls[1.0]
    as_printed = evidence.scattered.rml_printed
    starts = settling(
        evidence.data.scattered, evidence.data.new, UNSETTLED * evidence.scattered.lsm_rmse, PIECES
    )
    return Claim(
        5,
        "Scattered data: RML ends as accurate as RLS, but converges more slowly.",
        (
            Part(
                "difference of the errors at the end, over that of RLS",
                "",
                "at most",
                0.05,
                WHY_SAME_ACCURACY,
                (abs(rml.final / rls.final - 1.0),),
                (abs(as_printed.final / rls.final - 1.0),),
                "(29)",
            ),
            Part(
                "samples until RML settles, over those of RLS",
                "",
                "more than",
                1.2,
                WHY_SLOWER,
                (_ratio(starts["RML"], starts["RLS"]),),
                (_ratio(starts["RML as printed"], starts["RLS"]),),
                "(29)",
            ),
        ),
        (
            f"Median of {PIECES} starts: {', '.join(f'{k} {v:g}' for k, v in starts.items())} "
            f"samples until the error stays within √2 times what LSM of all samples leaves."
        ),
    )


def claim_6(evidence: Evidence) -> Claim:
    """Scattered: RBF does not converge."""
    return Claim(
        6,
        "Scattered data: the RBF network does not converge.",
        (
            Part(
                "the RBF network is far from convergence",
                "",
                "more than",
                1.0,
                WHY_CONVERGED,
                (evidence.scattered.rbf.unrest,),
                (evidence.scattered.rbf_printed.unrest,),
                "(37)",
            ),
        ),
        (
            f"Error at the end: {evidence.scattered.rbf.final:.3g} l/min with H_j in (37), "
            f"{_spelt(evidence.scattered.rbf_printed.final)} without it."
        ),
    )


def claim_13(evidence: Evidence) -> Claim:
    """After an abrupt damage λ = 1 cannot follow."""
    ends = {lam: evidence.damage.end(lam) for lam in LAMBDAS}
    best = min(ends, key=lambda lam: ends[lam])
    return Claim(
        13,
        "After an abrupt damage, RLS with λ = 1 cannot follow.",
        (
            Part(
                "error of λ = 1 after the damage, over that of a fresh start",
                "",
                "more than",
                UNSETTLED,
                WHY_FOLLOWS,
                (ends[1.0],),
            ),
            Part(
                "error of the best λ < 1, over that of a fresh start",
                "",
                "at most",
                UNSETTLED,
                WHY_FOLLOWS,
                (min(end for lam, end in ends.items() if lam < 1.0),),
            ),
        ),
        (
            f"As many samples after the damage as before it. Best is λ = {best:g}; a fresh start "
            f"leaves {evidence.damage.fresh:.3g} l/min."
        ),
    )


def _pairs(structured: Lessons, scattered: Lessons) -> Iterator[tuple[str, Course, Course]]:
    yield "RLS with λ = 1", structured.rls[1.0], scattered.rls[1.0]
    yield "RML", structured.rml, scattered.rml
    yield "the RBF network", structured.rbf, scattered.rbf


def _widest(known: Lessons) -> float:
    """Return the largest 1 - λ with convergence down to λ; 0 if only λ = 1 does, NaN if none."""
    widest = math.nan
    for lam in sorted(LAMBDAS, reverse=True):
        if not known.rls[lam].converged:
            break
        widest = 1.0 - lam
    return widest


def _ratio(slow: float, fast: float) -> float:
    """Return slow / fast; infinite if only ``slow`` is, or ``fast`` is 0; NaN if undefined."""
    if fast == 0.0:
        return math.inf if slow > 0.0 else math.nan
    return math.nan if math.isinf(slow) and math.isinf(fast) else slow / fast


def _spelt(error: float) -> str:
    return f"{error:.3g} l/min" if math.isfinite(error) else "no finite number"
