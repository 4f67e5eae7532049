"""What may be called on the parts of an `Identification`: reading, and computing results.

Calls that change the state are methods of `Identification` itself, which notes them in a preview.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Times
from valvemap.pipeline.lane_failures import LaneFailure
from valvemap.pipeline.plausibility import Finding
from valvemap.pipeline.recommendation import Recommendation
from valvemap.pipeline.required_signal import Required
from valvemap.pipeline.results import Results, ValveResult
from valvemap.pipeline.review import Reviewed
from valvemap.pipeline.store_ports import Checkpoint
from valvemap.pipeline.valve_columns import Columns
from valvemap.pipeline.valve_state import Lane, ValveState
from valvemap.vocabulary.feed_forward import FeedForwardStatus
from valvemap.vocabulary.statuses import Status


class ReadableResults(Protocol):
    """The published results; fulfilled by `ResultTables`."""

    def of(
        self,
        valves: Sequence[int],
        lost: NDArray[np.bool_] | None = None,
        old: NDArray[np.bool_] | None = None,
    ) -> Iterator[Results]:
        """Yield the results of the given valves, one for each group with the same plan."""

    def one(self, valve: int) -> ValveResult:
        """Return the results of one valve."""

    def unknown(self, valve: int) -> Results:
        """Return Bad results of one valve, for use when `of` raises."""

    def recommendation(self, valve: int) -> Recommendation:
        """Return which estimator of one valve is recommended, and why."""

    def counters(self, valve: int) -> Mapping[str, int]:
        """Return the counts of one valve's aligned, lost and rejected samples since the start."""

    def waited_for(self, valve: int) -> tuple[str, ...]:
        """Return the signals that are missing for a valve's samples, and a remedy."""


class ReadableMaps(Protocol):
    """Inverse tables and surveys; results contain the newest. Fulfilled by `MapsAndSurveys`."""

    def refresh(self, share: float = 1.0) -> None:
        """Compute the next due ones, or a share of them, so that other work is not delayed."""

    def refresh_all(self) -> None:
        """Compute every one."""


class ReadableAnswers(Protocol):
    """Answers to standing demands; fulfilled by `EstimatorCommands`."""

    def demands(self) -> Mapping[str, tuple[float, float]]:
        """Return the standing demands by valve: flow, l/min, and pressure drop, bar."""

    def required(self, valve: int) -> tuple[Required, Status]:
        """Return the answer to a valve's standing demand, and its estimator's status."""


class ReadableArming(Protocol):
    """Feed-forward; fulfilled by `ArmedValves`."""

    def is_armed(self, valve: int) -> bool:
        """Whether an operator has armed the valve's feed-forward since the start."""

    def feed_forward(self, valve: int) -> FeedForwardStatus:
        """Return the feed-forward status of the last step."""


class ReadableArrivals(Protocol):
    """Samples that wait; fulfilled by `Arrivals`."""

    def waits(self) -> NDArray[np.bool_]:
        """Mask of the valves with samples in the reorder buffer."""

    def pending(self) -> Times:
        """Number of samples of each valve that wait for signals or for earlier samples."""


class ReadableTiming(Protocol):
    """How signals are stamped; fulfilled by `Timing`."""

    @property
    def holds(self) -> NDArray[np.bool_]:
        """Mask of the valves with on-change signals: their silence is no loss."""

    def newly_found(self) -> list[int]:
        """Return the valves whose signals were newly found to have different timestamps."""


class ReadablePlausibility(Protocol):
    """Implausible samples; fulfilled by `SampleIntake`."""

    @property
    def implausible(self) -> NDArray[np.bool_]:
        """Mask of the valves whose samples are rejected as implausible.

        Impossible pressures are rejected until ten times as many samples have been right;
        inconsistent flow and pressures, until a restart.
        """

    def findings(self, valve: int) -> list[Finding]:
        """Return the reasons why a valve's signals are implausible."""


class ReadableValves(Protocol):
    """The valves' own states; fulfilled by `AllValves`."""

    def one_of_each_kind(self) -> list[int]:
        """Return the first valve of each group with the same plan."""

    def lane(self, valve: str, estimator: str) -> Lane:
        """Return one estimator of one valve."""

    def state(self, valve: int) -> ValveState:
        """Return the state of one valve."""


class ReadableFailures(Protocol):
    """Lanes that stopped; fulfilled by `LaneFailures`."""

    def take_new(self) -> list[LaneFailure]:
        """Return the lanes that stopped since the last call."""


class ReadableStates(Protocol):
    """States as bytes; fulfilled by `KeptStates`."""

    def kept(self, valves: Iterable[int] | None = None) -> list[Checkpoint]:
        """Return `checkpoints` and `memories` of the given valves, or of all."""

    def checkpoints(self, valves: Iterable[int] | None = None) -> list[Checkpoint]:
        """Return every estimator's state, of the given valves or of all."""

    def memories(self, valves: Iterable[int] | None = None) -> list[Checkpoint]:
        """Return the state beside the estimators, of the given valves or of all."""

    def review(self, stored: Sequence[Checkpoint]) -> Reviewed:
        """Compare stored checkpoints with the configuration, see :func:`review.review`."""


class ReadableColumns(Protocol):
    """The state of all valves as columns; fulfilled by `KeptColumns`."""

    def columns(self) -> list[Columns]:
        """Return it, without baselines."""

    def baselines(self) -> dict[str, bytes]:
        """Return the approved maps, packed, by valve."""
