"""Verdicts on the thirteen claims of the paper."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

from paper import claims_convergence as convergence
from paper import claims_map as of_the_map
from paper import claims_use as use
from paper.evidence import Evidence
from paper.notes import (
    passes_until_the_network_wins,
    what_closes_the_open_points,
)
from paper.verdict import Claim

CLAIMS: Final[tuple[Callable[[Evidence], Claim], ...]] = (
    convergence.claim_1,
    convergence.claim_2,
    convergence.claim_3,
    convergence.claim_4,
    convergence.claim_5,
    convergence.claim_6,
    of_the_map.claim_7,
    use.claim_8,
    of_the_map.claim_9,
    of_the_map.claim_10,
    use.claim_11,
    use.claim_12,
    convergence.claim_13,
)
ASIDES: Final[dict[int, Callable[[Evidence], str]]] = {
    2: passes_until_the_network_wins,
    10: what_closes_the_open_points,
}


def judge(sets: Sequence[Evidence]) -> list[Claim]:
    """Return the verdicts on all claims; each figure is the median over the sets of recordings."""
    return [Claim.merged([claim(evidence) for evidence in sets]) for claim in CLAIMS]


def with_asides(claims: Sequence[Claim], evidence: Evidence) -> list[Claim]:
    """Extend the notes by slower evaluations, which do not affect the verdicts."""
    return [
        replace(claim, note=f"{claim.note} {ASIDES[claim.number](evidence)}")
        if claim.number in ASIDES
        else claim
        for claim in claims
    ]
