"""The valves of an identification, as what feed-forward leads."""

from collections.abc import Callable, Mapping, Sequence

from valvemap.pipeline.feedforward import FeedForward, Situation
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.lane_failures import Step
from valvemap.vocabulary.statuses import FeedForwardStatus


class LedValves:
    """Implements `Led`.

    Parameters
    ----------
    identification
        Provides the required U and the armed valves.
    situation
        Returns the connection, sample age and map status of a valve.
    note_new
        Called with the valves that have new results to publish.
    """

    def __init__(
        self,
        identification: Identification,
        situation: Callable[[int], Situation],
        note_new: Callable[[Sequence[int]], None],
    ) -> None:
        self._identification = identification
        self._note_new = note_new
        self.situation = situation

    @property
    def settings(self) -> Mapping[int, FeedForward]:
        """Settings of each configured valve."""
        plans = enumerate(self._identification.plans)
        return {n: plan.feed_forward for n, plan in plans if plan.feed_forward is not None}

    def name(self, number: int) -> str:
        """Name of a valve."""
        return self._identification.plans[number].name

    def note_status(self, number: int, status: FeedForwardStatus) -> None:
        """Publish a new status."""
        self._identification.note_feed_forward(number, status)
        self._note_new([number])

    def fail(self, number: int, error: Exception) -> None:
        """Stop the inverse of a valve after an unexpected error."""
        inverse = self._identification.plans[number].inverse
        self._identification.stop(number, Step.INVERSE, error, inverse)
