"""A change of the plant, as an estimator found it."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from valvemap.model.samples import Times


@dataclass(frozen=True)
class Change:
    """An abrupt change of the plant.

    Attributes
    ----------
    count : int
        How many changes were found so far, this one included.
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
    """An estimator that may look for abrupt changes of the plant."""

    def change_counts(self, states: Any) -> Times:  # noqa: ANN401 - its own states
        """How many changes were found of each of M plants (M,)."""

    def last_change(self, state: Any) -> Change | None:  # noqa: ANN401 - its own state
        """Return the last change of one plant that was found, None if there was none."""
