"""Which valves people have armed for feed-forward, and whether answers are written to them."""

import numpy as np

from valvemap.errors import CommandRejected
from valvemap.pipeline.all_valves import AllValves
from valvemap.vocabulary.statuses import FeedForwardStatus

_AT_FIRST = {False: FeedForwardStatus.NOT_CONFIGURED, True: FeedForwardStatus.DISARMED}


class ArmedValves:
    """Nobody is armed after a start: somebody must do it again.

    Parameters
    ----------
    valves
        Of these.

    Attributes
    ----------
    armed : bool
        Which valves (V,) are.
    status : uint8
        How feed-forward stands at each of them, (V,).
    """

    def __init__(self, valves: AllValves) -> None:
        self._valves = valves
        self.armed = np.zeros(len(valves.plans), np.bool_)
        self.status = np.array(
            [_AT_FIRST[plan.feed_forward is not None] for plan in valves.plans], np.uint8
        )

    def arm(self, valve: str) -> None:
        """Have the answer to the standing demand written to the valve, while it may be.

        Raises
        ------
        CommandRejected
            if it is not configured where to.
        """
        number = self._valves.numbers[valve]
        if self._valves.plans[number].feed_forward is None:
            raise CommandRejected(f"{valve}: nodes.required_U is not configured")
        self.armed[number] = True

    def disarm(self, valve: str) -> None:
        """Write nothing to the valve any more."""
        self.armed[self._valves.numbers[valve]] = False

    def is_armed(self, valve: int) -> bool:
        """Whether somebody has armed the valve's feed-forward since the start."""
        return bool(self.armed[valve])

    def feed_forward(self, valve: int) -> FeedForwardStatus:
        """Whether the answer was written to the valve when last looked at."""
        return FeedForwardStatus(int(self.status[valve]))

    def note(self, valve: int, status: FeedForwardStatus) -> None:
        """Have a valve's feed-forward stand so."""
        self.status[valve] = status
