"""Valves whose newest sample is too old, or comes no more."""

from collections.abc import Sequence

import numpy as np

from valvemap.clock import Clock
from valvemap.model.samples import Flags, Floats, Times
from valvemap.runtime.sample_ages import SampleAges
from valvemap.runtime.waiting_time import WaitingTime

OLD = 2.0  # times `stale_after_s`; a sample older than this makes results Bad


class StaleSamples:
    """Compares the samples of M valves with a limit of their age.

    Parameters
    ----------
    M
        Number of valves.
    limit_s
        Largest age of a sample.
    ages
        By the clocks of the sources.
    lost, old
        Masks (M,) of the valves whose results are Bad or Uncertain; written.

    Attributes
    ----------
    connected : (M,)
        Mask of the valves whose source is connected; written by the caller.
    """

    def __init__(
        self, M: int, limit_s: float, ages: SampleAges, clock: Clock, lost: Flags, old: Flags
    ) -> None:
        now = clock.monotonic()
        self._limit_s, self._ages, self._clock = limit_s, ages, clock
        self._lost, self._old = lost, old
        self._last_sample = np.full(M, now)
        self._heard_at = np.full(M, now)  # last change of their source
        self._silent = WaitingTime(M, limit_s, now)
        self.connected = np.zeros(M, np.bool_)
        self._every = np.ones(M, np.bool_)

    def note_source(self, valves: Times) -> float:
        """Note that the source of these valves has sent something; return the monotonic time, s."""
        self.connected[valves] = True
        self._heard_at[valves] = now = self._clock.monotonic()
        return now

    def note_samples(self, members: Times, newest: Times, holds: Flags) -> None:
        """Note the times of the newest samples of the given valves, UTC ns; write `lost` and `old`.

        ``holds`` is the mask (M,) of valves with on-change signals.
        """
        if not len(members):
            return
        self._last_sample[members] = self._clock.monotonic()
        self._silent.heard(members)
        self._ages.note(members, newest)
        ages, steady = self._ages.of()[members], ~holds[members]
        self._lost[members] = steady & (ages > OLD * self._limit_s)
        self._old[members] = steady & (ages > self._limit_s)

    def find_stale(self, now: float, ages: Floats, holds: Flags) -> tuple[Times, Times]:
        """Return the valves that are stale, and those of them that are silent.

        Results are old whatever the reason; a valve is silent if nothing has come while this
        process listened.
        """
        at_rest = holds & self.connected  # on-change signals
        none_came = now - self._last_sample > self._limit_s
        stale = (none_came | (ages > OLD * self._limit_s)) & ~at_rest
        due = self._silent.due(now, self._every, ~at_rest)
        if not np.count_nonzero(stale):
            return _NONE, _NONE
        listened = np.zeros_like(stale)
        listened[due] = True
        return stale.nonzero()[0], (stale & (listened | ~none_came)).nonzero()[0]

    def find_old(self, ages: Floats, holds: Flags) -> Times:
        """Return the valves that are newly old; write `old`."""
        old = ((ages > self._limit_s) & ~self._old & ~(holds & self.connected)).nonzero()[0]
        self._old[old] = True
        return old

    def age_s(self, valve: int) -> float:
        """Return the age of a valve's newest sample, at least the time since it came, s."""
        waited = self._clock.monotonic() - self._last_sample[valve]
        return max(float(waited), float(self._ages.of(slice(valve, valve + 1))[0]))

    def why(self, valve: int, waited_for: Sequence[str]) -> str:
        """Return why a valve has no samples; ``waited_for`` says which signals are missing."""
        silent_s = self._clock.monotonic() - self._heard_at[valve]
        if silent_s > self._limit_s or not self.connected[valve]:
            return f"nothing has come from its source for {silent_s:.1f} s"
        return "; ".join(waited_for) or "nothing comes any more"


_NONE: Times = np.zeros(0, np.int64)
