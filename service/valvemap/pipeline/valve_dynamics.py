"""Dynamics of valves while they work: whose samples are gathered, what the fits found. Pure.

A fit takes seconds, and wants a minute of samples at 100 Hz. Few valves gather at once, in turn, so
that neither memory nor processor time depend on the number of valves. The caller runs each fit
beside everything else and accepts its outcome.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Final

import numpy as np

from valvemap.model.dynamics import LEAST_HZ, Dynamics, NotFitted, Quantity, fit_dynamics
from valvemap.model.samples import Samples
from valvemap.pipeline.alignment import ByValve
from valvemap.pipeline.dynamics_results import DynamicsResults
from valvemap.vocabulary.dynamics import DYNAMIC_QUANTITIES, DynamicsStatus
from valvemap.vocabulary.findings import Finding, FindingCode
from valvemap.vocabulary.statuses import Status

MOST_SAMPLES: Final = 60_000  # of a window, if samples come very quickly
AT_ONCE: Final = 8  # valves that gather samples: 2 MB each at 1 kHz
RATE_S: Final = 5.0  # s over which samples are counted
CHANGED: Final = 0.2  # relative change that matters, beyond its uncertainty
SURE: Final = 4.0  # standard deviations

Outcome = Dynamics | NotFitted
Job = Callable[[], Outcome]


class ValveDynamics:
    """The results of one valve's fits, compared with the first good one.

    Examples
    --------
    >>> ValveDynamics().accept(fit_dynamics(Samples.empty()), 0).status.label
    'waiting'
    """

    def __init__(self) -> None:
        self._first: Dynamics | None = None

    def accept(self, outcome: Outcome, t: int) -> DynamicsResults:
        """Return the results after a fit of samples up to ``t``, UTC ns."""
        if isinstance(outcome, NotFitted):
            return DynamicsResults(outcome.status, outcome.sentence, t)
        quantities = tuple(getattr(outcome, q.field) for q in DYNAMIC_QUANTITIES)
        f = outcome.natural_frequency
        if f.status is not Status.OK:
            status = DynamicsStatus.UNEXCITED
            return DynamicsResults(status, status.sentence, t, quantities)
        if self._first is None:
            self._first = outcome
        before = self._first.natural_frequency
        moved = math.log(f.value / before.value)
        spread = math.hypot(f.std / f.value, before.std / before.value)
        sentence = _in_words(outcome)
        if abs(moved) < CHANGED + SURE * spread:
            return DynamicsResults(DynamicsStatus.OK, sentence, t, quantities)
        cause = "a sticky spool or a low" if moved < 0.0 else "a higher"
        why = (
            f"The spool's natural frequency went from {before.value:.3g} to {f.value:.3g} ± "
            f"{1.96 * f.std:.2g} Hz: {cause} pilot pressure may be the cause."
        )
        sure = math.erf((abs(moved) - CHANGED) / max(spread, 1e-9) / math.sqrt(2.0))
        finding = Finding(FindingCode.DYNAMICS_CHANGE, sure, why)
        return DynamicsResults(DynamicsStatus.OK, sentence, t, quantities, (finding,))


class DynamicsInTurn:
    """Gathers samples of a few valves at a time, and says which fit is due.

    Parameters
    ----------
    valves
        Their number.
    share
        Of one core, that fits may take; above 0.
    window_s
        s of samples for a fit.
    now
        Monotonic time, s.
    """

    def __init__(self, valves: int, share: float, window_s: float, now: float) -> None:
        self._rest = 1.0 / share - 1.0  # times the duration of a fit
        self._window_s = window_s
        self._counts = np.zeros(valves, np.int64)
        self._since = now
        self._is_fast = np.zeros(valves, np.bool_)
        self._is_slow = np.zeros(valves, np.bool_)
        self._gathered: dict[int, _Window] = {}
        self._next = 0  # the valve from which the next to gather is sought
        self._rests_until = now
        self._works = False

    def take(self, samples: ByValve, now: float) -> list[int]:
        """Take samples; return the valves that are newly known to be too slow."""
        members, starts, stops = samples.segments
        self._counts[members] += stops - starts
        for valve, window in self._gathered.items():
            batch = samples.get(valve)
            if batch is not None:
                window.take(batch)
        passed = now - self._since
        if passed < RATE_S:
            return []
        fast = self._counts >= LEAST_HZ * passed
        slow = (self._counts > 0) & ~fast & ~self._is_fast
        newly = np.flatnonzero(slow & ~self._is_slow).tolist()
        self._is_fast |= fast
        self._is_slow |= slow
        self._counts[:], self._since = 0, now
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
        """Note that a fit has ended; the next rests in proportion, another valve gathers."""
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
    """The newest samples of one valve, in batches of their own memory."""

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


def _in_words(found: Dynamics) -> str:
    parts = []
    for quantity in DYNAMIC_QUANTITIES:
        one: Quantity = getattr(found, quantity.field)
        if one.status is Status.OK:
            unit, factor = quantity.in_words
            shown = f"{factor * one.value:.3g} ± {1.96 * factor * one.std:.1g}"
            parts.append(f"{quantity.name} {shown}{'' if unit == '1' else f' {unit}'}")
        else:
            parts.append(f"{quantity.name} not excited")
    return f"{', '.join(parts)}; residual {found.noise:.2g} l/min."
