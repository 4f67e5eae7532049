"""What a valve's dynamics are compared with: those of its first good fit, kept. Pure."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from valvemap.model.contents import Contents
from valvemap.model.dynamics import Dynamics, NotFitted, Quantity
from valvemap.model.estimator import State
from valvemap.pipeline.dynamics_results import DynamicsResults
from valvemap.vocabulary.dynamics import DYNAMIC_QUANTITIES, DynamicsStatus
from valvemap.vocabulary.findings import Finding, FindingCode
from valvemap.vocabulary.statuses import Status

CHANGED: Final = 0.2  # relative change that matters, beyond its uncertainty
SURE: Final = 4.0  # standard deviations
KEY: Final = "dynamics 1"  # version of the storage format
MOST_HZ: Final = 1e5  # Hz; of any spool

Outcome = Dynamics | NotFitted


@dataclass(frozen=True)
class DynamicsReference(State):
    """Natural frequency and its standard deviation, Hz; time of the newest sample, UTC ns; ()."""

    natural_frequency: Any
    std: Any
    t: Any

    def contents(self) -> Mapping[str, Contents]:
        """Return the permitted content."""
        return {
            "natural_frequency": Contents(self.natural_frequency).within(1e-3, MOST_HZ),
            "std": Contents(self.std).within(0.0, MOST_HZ),
        }


class DynamicsReferences:
    """The reference of each valve that has one.

    Attributes
    ----------
    of : dict
        References by the valve's number.

    Examples
    --------
    >>> from valvemap.model.samples import Samples
    >>> from valvemap.model.dynamics import fit_dynamics
    >>> DynamicsReferences().judge(0, fit_dynamics(Samples.empty()), 0).status.label
    'waiting'
    """

    def __init__(self) -> None:
        self.of: dict[int, DynamicsReference] = {}

    def judge(self, valve: int, outcome: Outcome, t: int) -> DynamicsResults:
        """Return the results after a fit of samples up to ``t``, UTC ns.

        The first good fit becomes the reference.
        """
        if isinstance(outcome, NotFitted):
            return DynamicsResults(outcome.status, outcome.sentence, t)
        quantities = tuple(getattr(outcome, q.field) for q in DYNAMIC_QUANTITIES)
        f = outcome.natural_frequency
        if f.status is not Status.OK:
            status = DynamicsStatus.UNEXCITED
            return DynamicsResults(status, status.sentence, t, quantities)
        known = DynamicsReference(np.array(f.value), np.array(f.std), np.array(t, np.int64))
        finding = _change(self.of.setdefault(valve, known), f)
        found = () if finding is None else (finding,)
        return DynamicsResults(DynamicsStatus.OK, _in_words(outcome), t, quantities, found)

    def forget(self, valve: int) -> None:
        """Take the next good fit as the reference."""
        self.of.pop(valve, None)

    def from_bytes(self, valve: int, data: bytes) -> None:
        """Restore a reference that ``to_bytes`` packed.

        Raises
        ------
        StateMismatchError
            if it is damaged.
        """
        zero = np.array(0.0)
        kept = DynamicsReference.from_bytes(data, KEY)
        kept.check(DynamicsReference(zero, zero, np.array(0, np.int64)))
        self.of[valve] = kept


def _change(before: DynamicsReference, f: Quantity) -> Finding | None:
    was, std = float(before.natural_frequency), float(before.std)
    moved = math.log(f.value / was)
    spread = math.hypot(f.std / f.value, std / was)
    if abs(moved) < CHANGED + SURE * spread:
        return None
    cause = "a sticky spool or a low" if moved < 0.0 else "a higher"
    why = (
        f"The spool's natural frequency went from {was:.3g} to {f.value:.3g} ± "
        f"{1.96 * f.std:.2g} Hz: {cause} pilot pressure may be the cause."
    )
    sure = math.erf((abs(moved) - CHANGED) / max(spread, 1e-9) / math.sqrt(2.0))
    return Finding(FindingCode.DYNAMICS_CHANGE, sure, why)


def _in_words(found: Dynamics) -> str:
    parts = []
    for quantity in DYNAMIC_QUANTITIES:
        one: Quantity = getattr(found, quantity.field)
        if one.status is Status.OK:
            unit, factor = quantity.in_words
            shown = f"{factor * one.value:.3g} ± {1.96 * factor * one.std:.1g}"
            parts.append(f"{quantity.name} {shown}{'' if unit == '1' else f' {unit}'}")
        else:
            parts.append(f"{quantity.name} not excited")
    if found.play_percent > 0.0:
        parts.append(f"play {found.play_percent:.2g} %")
    return f"{', '.join(parts)}; residual {found.noise:.2g} l/min."
