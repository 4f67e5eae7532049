"""The valves of an identification, as what feed-forward leads."""

from collections.abc import Callable, Mapping, Sequence

from valvemap.model.samples import Floats
from valvemap.pipeline.feedforward import FeedForward, Situation
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.lane_failures import Step
from valvemap.pipeline.required_signal import Required
from valvemap.runtime.stale_samples import StaleSamples
from valvemap.vocabulary.feed_forward import FeedForwardStatus
from valvemap.vocabulary.statuses import Status


class LedValves:
    """Implements `Led`.

    Parameters
    ----------
    identification
        Provides the required U and the armed valves.
    stale, newest_U
        Connection and age of the valves' samples, and the signal U of the newest, % (M,).
    note_new
        Called with the valves that have new results to publish.
    """

    def __init__(
        self,
        identification: Identification,
        stale: StaleSamples,
        newest_U: Floats,
        note_new: Callable[[Sequence[int]], None],
    ) -> None:
        self._identification = identification
        self._stale, self._newest_U = stale, newest_U
        self._note_new = note_new
        self._answers: dict[int, tuple[tuple[int, ...], Required, Status]] = {}  # by version

    @property
    def settings(self) -> Mapping[int, FeedForward]:
        """Settings of each configured valve."""
        plans = enumerate(self._identification.plans)
        return {n: plan.feed_forward for n, plan in plans if plan.feed_forward is not None}

    def name(self, number: int) -> str:
        """Name of a valve."""
        return self._identification.plans[number].name

    def situation(self, number: int) -> Situation:
        """Return the connection of a valve, and, if it is armed, its sample and its answer."""
        armed = self._identification.armed.is_armed(number)
        connected = bool(self._stale.connected[number])
        if not (armed and connected):
            return Situation(armed, connected)
        answer, status = self._answer(number)
        return Situation(
            armed=armed,
            connected=True,
            age_s=self._stale.age_s(number),
            U=float(self._newest_U[number]),
            map=status,
            required_U=answer.U,
            width=answer.width,
            answer=answer.status,
        )

    def _answer(self, number: int) -> tuple[Required, Status]:
        """Return the answer to the standing demand; between two samples it stays the same."""
        version = self._identification.version
        known = self._answers.get(number)
        if known is None or known[0] != version:
            known = version, *self._identification.answers.required(number)
            self._answers[number] = known
        _, answer, status = known
        return answer, status

    def note_status(self, number: int, status: FeedForwardStatus) -> None:
        """Publish a new status."""
        self._identification.note_feed_forward(number, status)
        self._note_new([number])

    def fail(self, number: int, error: Exception) -> None:
        """Stop the inverse of a valve after an unexpected error."""
        inverse = self._identification.plans[number].inverse
        self._identification.stop(number, Step.INVERSE, error, inverse)
