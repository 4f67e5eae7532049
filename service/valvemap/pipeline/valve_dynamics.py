"""Dynamics of valves while they work: whose samples are gathered, which fit is due. Pure.

A fit takes seconds, and wants a minute of samples at 100 Hz. Few valves gather at once, in turn, so
that neither memory nor processor time depend on the number of valves. The caller runs each fit
beside everything else and accepts its outcome.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Final

import numpy as np

from valvemap.model.dynamics import LEAST_HZ, fit_dynamics
from valvemap.model.samples import Samples
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.dynamics_reference import Outcome

MOST_SAMPLES: Final = 60_000  # of a window, if samples come very quickly
AT_ONCE: Final = 8  # valves that gather samples: 2 MB each at 1 kHz
RATE_S: Final = 5.0  # s over which samples are counted

Job = Callable[[], Outcome]


class DynamicsInTurn:
    """Gathers samples of a few valves at a time, and selects the fit that is due.

    Parameters
    ----------
    valves
        Their number.
    share
        Of one core, that fits may take, in processor time; above 0.
    window_s
        s of samples for a fit.
    now
        Monotonic time, s.
    """

    def __init__(self, valves: int, share: float, window_s: float, now: float) -> None:
        self._rest = 1.0 / share - 1.0  # times the duration of a fit
        self._window_s = window_s
        self._counts, self._first = np.zeros(valves, np.int64), np.zeros(valves, np.int64)
        self._is_fast = np.zeros(valves, np.bool_)
        self._is_slow = np.zeros(valves, np.bool_)
        self._gathered: dict[int, _Window] = {}
        self._next = 0  # the valve from which the next to gather is sought
        self._rests_until = now
        self._works = False

    def take(self, samples: ByValve) -> list[int]:
        """Take samples; return the valves that are newly known to be too slow.

        Their rate is that of their own times: a busy machine, or a late connection, is none.
        """
        members, starts, stops = samples.segments
        for valve, window in self._gathered.items():
            batch = samples.get(valve)
            if batch is not None:
                window.take(batch)
        t, is_first = samples.samples.t, self._counts[members] == 0
        self._first[members[is_first]] = t[starts[is_first]]
        self._counts[members] += stops - starts
        span_s = 1e-9 * (t[stops - 1] - self._first[members])
        self._counts[members[span_s < 0.0]] = 0
        is_due = span_s >= RATE_S
        if not is_due.any():
            return []
        due, span_s = members[is_due], span_s[is_due]
        fast = self._counts[due] > LEAST_HZ * span_s
        slow = ~fast & ~self._is_fast[due]
        newly = due[slow & ~self._is_slow[due]].tolist()
        self._is_fast[due] |= fast
        self._is_slow[due] |= slow
        self._counts[due] = 0
        self._choose()
        return list(newly)

    def job(self, now: float) -> tuple[int, int, Job] | None:
        """Return the valve, the time of its newest sample and the fit that is due, if one is."""
        if self._works or now < self._rests_until:
            return None
        for valve, window in self._gathered.items():
            if window.is_full:
                self._works = True
                samples = window.samples()
                return valve, int(samples.t[-1]), partial(fit_dynamics, samples)
        return None

    def end(self, valve: int, took_s: float, now: float) -> None:
        """Note that a fit has ended after ``took_s`` of processor time; the next rests accordingly.

        Another valve gathers.
        """
        self._works = False
        self._rests_until = now + took_s * self._rest
        window = self._gathered.pop(valve)
        if np.count_nonzero(self._is_fast) <= AT_ONCE:
            self._gathered[valve] = window  # behind the others
        self._choose()

    def _choose(self) -> None:
        fast = np.flatnonzero(self._is_fast)
        for valve in np.roll(fast, -int(np.searchsorted(fast, self._next))).tolist():
            if len(self._gathered) >= AT_ONCE:
                return
            if valve not in self._gathered:
                self._gathered[valve] = _Window(self._window_s)
                self._next = valve + 1


@dataclass
class _Window:
    """The newest samples of one valve, in batches with separate memory."""

    window_s: float
    _batches: deque[Samples] = field(default_factory=deque)
    _n: int = 0

    def take(self, batch: Samples) -> None:
        self._batches.append(Samples.concatenate([batch]))  # a copy: a view keeps all valves' alive
        self._n += len(batch)
        while self._held_s(1) >= self.window_s or self._n - len(self._batches[0]) >= MOST_SAMPLES:
            self._n -= len(self._batches.popleft())

    @property
    def is_full(self) -> bool:
        """Whether it holds what a fit needs."""
        return self._held_s(0) >= self.window_s or self._n >= MOST_SAMPLES

    def samples(self) -> Samples:
        return Samples.concatenate(list(self._batches))

    def _held_s(self, first: int) -> float:
        if len(self._batches) <= first:
            return 0.0
        return 1e-9 * float(self._batches[-1].t[-1] - self._batches[first].t[0])
