"""Results on the dynamics of one valve."""

from dataclasses import dataclass
from typing import Final

from valvemap.model.dynamics import Quantity
from valvemap.vocabulary.dynamics import DYNAMIC_QUANTITIES, DynamicsStatus
from valvemap.vocabulary.findings import Finding


@dataclass(frozen=True)
class DynamicsResults:
    """Results of the newest fit; ``quantities`` are in the order of the table.

    ``t`` is the time of the newest sample that was used, UTC ns; 0: none.
    """

    status: DynamicsStatus = DynamicsStatus.WAITING
    sentence: str = DynamicsStatus.WAITING.sentence
    t: int = 0
    quantities: tuple[Quantity, ...] = (Quantity(),) * len(DYNAMIC_QUANTITIES)
    findings: tuple[Finding, ...] = ()


NOTHING_YET: Final = DynamicsResults()
