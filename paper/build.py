"""The complete report: evidence, verdicts, errata, pictures; also as JSON."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from paper import pictures_data, pictures_runs, pictures_tables
from paper.claims import judge, with_asides
from paper.claims_data import claim_15
from paper.claims_motion import claim_14
from paper.data import PaperData
from paper.errata import show
from paper.erratum import Erratum
from paper.evidence import Evidence
from paper.motion import Motion
from paper.picture import Picture
from paper.source_types import SourceTypes
from paper.verdict import Claim, Part
from valvemap.model.rbf_network import RbfNetwork

Progress = Callable[[str], None]


@dataclass(frozen=True)
class PaperReport:
    """The contents of the page."""

    rate_hz: float
    samples: int
    sets: int
    claims: Sequence[Claim]
    faster_hz: float
    claims_faster: Sequence[Claim]
    errata: Sequence[Erratum]
    figures: Sequence[Picture]
    tables: Sequence[Picture]
    runs: Sequence[Picture]

    @property
    def pictures(self) -> list[Picture]:
        """All pictures, in the order of the page."""
        return [*self.figures, *self.tables, *self.runs]


def build(
    sets: Sequence[PaperData],
    faster: PaperData,
    network: RbfNetwork | None = None,
    motion: Motion | None = None,
    types: SourceTypes | None = None,
    progress: Progress = lambda _step: None,
) -> PaperReport:
    """Reproduce the paper.

    Parameters
    ----------
    sets
        Sets of recordings of the same valve with different noise; the pictures use the first one.
    faster
        A set at a higher sampling rate, to check how the verdicts depend on it.
    network
        Settings of the network, whose size and rates the paper does not give.
    motion
        A cylinder that follows moves, for the paper's open point; None: it is not judged.
    types
        Maps from the source data of the paper's Figure 1; None: it is not judged.
    progress
        Called before each step with its name, STEPS times (and once more for each set).
    """
    network = RbfNetwork() if network is None else network
    evidence = []
    for number, data in enumerate(sets, start=1):
        progress(f"learning from recordings {number} of {len(sets)}")
        evidence.append(Evidence.of(data, network))
    progress("judging the claims")
    claims = with_asides(judge(evidence), evidence[0])
    progress(f"the same at {faster.rate_hz:g} samples/s")
    claims_faster = judge([Evidence.of(faster, network)])
    if motion is not None:
        claims, claims_faster = ([*judged, claim_14(motion)] for judged in (claims, claims_faster))
    if types is not None:
        claims, claims_faster = ([*judged, claim_15(types)] for judged in (claims, claims_faster))
    progress("showing the errata")
    errata = show(sets[0], network)
    progress("drawing")
    first, data = evidence[0], sets[0]
    return PaperReport(
        rate_hz=data.rate_hz,
        samples=len(data.structured),
        sets=len(sets),
        claims=claims,
        faster_hz=faster.rate_hz,
        claims_faster=claims_faster,
        errata=errata,
        figures=[
            pictures_data.figure_4(data),
            pictures_data.figure_7(data),
            pictures_data.figure_8(data),
            pictures_data.figure_9(data),
        ],
        tables=[pictures_tables.table_1(first), pictures_tables.table_2(first)],
        runs=[
            pictures_runs.sweep(first, faster.structured),
            pictures_runs.courses(first),
            pictures_runs.damage(first),
            pictures_runs.extrapolation(first),
        ],
    )


STEPS = 4


def as_json(report: PaperReport) -> dict[str, Any]:
    """Return all numbers; non-finite ones are null."""
    return {
        "recordings": {
            "sets": report.sets,
            "samples": report.samples,
            "rate_hz": report.rate_hz,
            "faster_rate_hz": report.faster_hz,
        },
        "claims": [_claim(claim) for claim in report.claims],
        "claims_at_the_faster_rate": [_claim(claim) for claim in report.claims_faster],
        "errata": [_erratum(erratum) for erratum in report.errata],
        "pictures": {
            picture.key: {"title": picture.title, "series": picture.numbers}
            for picture in report.pictures
        },
    }


def _claim(claim: Claim) -> dict[str, Any]:
    return {
        "number": claim.number,
        "claim": claim.text,
        "verdict": str(claim.verdict),
        "sets_with_the_same_verdict": claim.agreeing,
        "parts": [_part(part) for part in claim.parts],
        "note": claim.note,
    }


def _part(part: Part) -> dict[str, Any]:
    return {
        "says": part.says,
        "unit": part.unit,
        "value": _number(part.value),
        "values": [_number(value) for value in part.values],
        "must_be": part.must,
        "limit": part.limit,
        "why": part.why,
        "holds": part.holds,
        "printed": [_number(value) for value in part.printed],
        "holds_as_printed": part.explained or part.holds if part.printed else None,
        "erratum": part.erratum or None,
    }


def _erratum(erratum: Erratum) -> dict[str, Any]:
    return {
        "equation": erratum.equation,
        "printed": erratum.printed,
        "right": erratum.right,
        "measure": erratum.measure,
        "printed_error": _number(erratum.printed_error),
        "right_error": _number(erratum.right_error),
        "limit": erratum.limit,
        "why": erratum.why,
        "printed_fails": erratum.printed_fails,
        "right_holds": erratum.right_holds,
    }


def _number(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
