"""Abrupt changes of the plant, as detected by an estimator."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from valvemap.model.samples import Times


@dataclass(frozen=True)
class Change:
    """An abrupt change of the plant.

    Attributes
    ----------
    count : int
        Number of changes detected so far, including this one.
    sample : int
        Number of the first sample (of those used, from 0) after the change, as estimated.
    t : int
        Time of the last sample before it, UTC ns.
    size : float
        Mean innovation from the change to its detection, l/min.
    """

    count: int
    sample: int
    t: int
    size: float


@runtime_checkable
class FindsChanges(Protocol):
    """An estimator with detection of abrupt plant changes."""

    def change_counts(self, states: Any) -> Times:  # noqa: ANN401 - its own states
        """Return the number of changes of each of M plants (M,)."""

    def last_change(self, state: Any) -> Change | None:  # noqa: ANN401 - its own state
        """Return the last detected change of one plant, None if there was none."""
