"""The axes of a service, as what feed-forward leads."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from valvemap.errors import CommandRejected
from valvemap.pipeline.axes import Axis
from valvemap.pipeline.axis_arrivals import LINES
from valvemap.pipeline.feedforward import FeedForward, Situation
from valvemap.vocabulary.feed_forward import FeedForwardStatus


class LedAxes:
    """Implements `Led`: row `LINES`·k of the source is that of axis k. None is armed at first.

    Parameters
    ----------
    axes
        The axes.
    age_s
        Age of the newest sample of an axis, s; None: its source is away, or it has failed.
    show
        Called with an axis whose status has changed.
    fail
        Called with an axis that an error has stopped.
    """

    def __init__(
        self,
        axes: Sequence[Axis],
        age_s: Callable[[int], float | None],
        show: Callable[[int], None],
        fail: Callable[[int, Exception], None],
    ) -> None:
        self._axes, self._age_s, self._show, self._fail = axes, age_s, show, fail
        self._is_armed = [False] * len(axes)
        self._status = [
            FeedForwardStatus.NOT_CONFIGURED
            if axis.plan.feed_forward is None
            else FeedForwardStatus.DISARMED
            for axis in axes
        ]

    def arm(self, axis: int, *, armed: bool) -> None:
        """Arm or disarm an axis.

        Raises
        ------
        CommandRejected
            if it has no node to write to.
        """
        plan = self._axes[axis].plan
        if armed and plan.feed_forward is None:
            raise CommandRejected(f"{plan.name}: nodes.required_U is not configured")
        self._is_armed[axis] = armed

    def shown(self, axis: int) -> tuple[bool, FeedForwardStatus]:
        """Return whether an axis is armed, and its status."""
        return self._is_armed[axis], self._status[axis]

    @property
    def settings(self) -> Mapping[int, FeedForward]:
        """Settings by row."""
        plans = ((LINES * k, axis.plan.feed_forward) for k, axis in enumerate(self._axes))
        return {row: given for row, given in plans if given is not None}

    def name(self, number: int) -> str:
        """Name of the axis of a row."""
        return self._axes[number // LINES].plan.name

    def situation(self, number: int) -> Situation:
        """Return whether it is armed, its sample and its answer."""
        axis = number // LINES
        armed, age_s = self._is_armed[axis], self._age_s(axis)
        if not armed or age_s is None:
            return Situation(armed, age_s is not None)
        return replace(self._axes[axis].situation(), age_s=age_s)

    def note_status(self, number: int, status: FeedForwardStatus) -> None:
        """Show a new status."""
        self._status[number // LINES] = status
        self._show(number // LINES)

    def fail(self, number: int, error: Exception) -> None:
        """Stop the axis alone."""
        self._fail(number // LINES, error)
