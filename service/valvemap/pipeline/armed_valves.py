"""Valves armed for feed-forward by an operator, and the status of their feed-forward."""

import numpy as np

from valvemap.errors import CommandRejected
from valvemap.pipeline.all_valves import AllValves
from valvemap.vocabulary.feed_forward import FeedForwardStatus

_AT_FIRST = {False: FeedForwardStatus.NOT_CONFIGURED, True: FeedForwardStatus.DISARMED}


class ArmedValves:
    """The armed valves; none is armed after a start.

    Parameters
    ----------
    valves
        The valves.

    Attributes
    ----------
    armed : bool
        Mask (V,) of the armed valves.
    status : uint8
        Feed-forward status of each valve, (V,).
    """

    def __init__(self, valves: AllValves) -> None:
        self._valves = valves
        self.armed = np.zeros(len(valves.plans), np.bool_)
        self._is_led = np.zeros(len(valves.plans), np.bool_)
        self.status = np.array(
            [_AT_FIRST[plan.feed_forward is not None] for plan in valves.plans], np.uint8
        )

    def arm(self, valve: str) -> None:
        """Arm feed-forward: the answer to the standing demand is written to the valve.

        Raises
        ------
        CommandRejected
            if no node to write to is configured, or a commissioning run leads the valve.
        """
        number = self._valves.numbers[valve]
        if self._valves.plans[number].feed_forward is None:
            raise CommandRejected(f"{valve}: nodes.required_U is not configured")
        if self._is_led[number]:
            raise CommandRejected(f"{valve}: a commissioning run leads the valve")
        self.armed[number] = True

    def lead(self, valve: str, *, by_another: bool) -> None:
        """Note whether something else writes to the valve; if so, it cannot be armed."""
        self._is_led[self._valves.numbers[valve]] = by_another

    def disarm(self, valve: str) -> None:
        """Disarm feed-forward: nothing is written to the valve."""
        self.armed[self._valves.numbers[valve]] = False

    def is_armed(self, valve: int) -> bool:
        """Whether an operator has armed the valve's feed-forward since the start."""
        return bool(self.armed[valve])

    def feed_forward(self, valve: int) -> FeedForwardStatus:
        """Return the feed-forward status of the last step."""
        return FeedForwardStatus(int(self.status[valve]))

    def note(self, valve: int, status: FeedForwardStatus) -> None:
        """Set a valve's feed-forward status."""
        self.status[valve] = status
