"""Faults planted in a reload of the configuration."""

from unittest import mock

from valvemap.runtime import supervisor
from valvemap.runtime.past import PastKeeper


def a_message_received_at_the_end_that_is_dropped():
    """A message that comes while the supervisor ends is received, and not taken."""
    ended = supervisor._ended

    async def dropping(receiving):
        await ended(receiving)

    return mock.patch.object(supervisor, "_ended", dropping)


def rows_that_wait_dropped_at_a_reload():
    """What a full disk has kept in the history's buffer is forgotten by a reload."""
    follow = PastKeeper.follow

    async def dropping(self, valves):
        self._samples, self._results = [], []
        await follow(self, valves)

    return mock.patch.object(PastKeeper, "follow", dropping)


RELOAD_FAULTS = (a_message_received_at_the_end_that_is_dropped, rows_that_wait_dropped_at_a_reload)
