"""Steps of the source's clock, for valves without running number. Pure.

A change of an OPC UA item is never sent before an earlier one. So a message whose times run back is
a repetition, or the clock was set back: the contents decide. They also tell a repetition from
before a step back, whose times lie in the future. A message whose newest time is further ahead of
our monotonic time than any before it is no late message: the clock was set forward.
"""

from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Times
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.kernels.waiting import (
    NEVER,
    SEEN,
    SET_BACK,
    SET_FORWARD,
    SIGNALS,
    Waiting,
)
from valvemap.vocabulary.signals import MEASURED, PER_VALVE

MOST_KNOWN: Final = 1024  # samples of each valve, as many as the alignment remembers
ANY: Final = 0  # digest of a content that is not known
_AHEAD_NS: Final = 400_000_000  # ns; less is jitter of the transmission
_SHARE: Final = 0.5  # of the lead that a gap between two samples must have, else messages catch up
_DRIFT: Final = 1e-4  # of two clocks; more than quartz has
_FACTORS: Final = np.array(
    [(2 * k + 1) * 0x9E3779B97F4A7C15 % 2**64 for k in range(SIGNALS)], np.uint64
)


class Step(NamedTuple):
    """A step of one valve's clock: before which row of a batch, and the alignment's command."""

    valve: int
    row: int
    command: int


class Known(NamedTuple):
    """Times and contents of a valve's last samples, (N,), N at most MOST_KNOWN.

    They are those from before and behind a step back of the clock; without one N is 0. A content is
    ANY after a change of units: the same time is then a repetition.
    """

    times: Times
    digests: NDArray[np.int64]

    @classmethod
    def nothing(cls, count: int = 0) -> Self:
        """Return the arrays of ``count`` samples, without content."""
        return cls(np.full(count, NEVER), np.zeros(count, np.int64))

    def of_any_content(self) -> Self:
        """Return the same samples in other units."""
        return self._replace(digests=np.full_like(self.digests, ANY))


_NOTHING_KNOWN: Final = Known.nothing()


class Found(NamedTuple):
    """Steps in a batch, by ascending row, and the mask of rows from before a step that repeat."""

    steps: list[Step]
    repeated: NDArray[np.bool_]


class ClockSteps:
    """Finds the steps in batches of changes.

    Parameters
    ----------
    required
        (V, SIGNALS) mask of the signals that each sample has.
    watched
        (V,) mask of the valves to watch: those without running number.
    reorder_ns
        (V,) how much earlier than the newest a change may be, ns.
    """

    def __init__(
        self, required: NDArray[np.bool_], watched: NDArray[np.bool_], reorder_ns: Times
    ) -> None:
        V = len(watched)
        self._required, self._watched, self._reorder = required, watched, reorder_ns
        self._row = np.cumsum(watched) - 1  # of a valve in the rings
        rings = int(watched.sum())
        self._times = np.full((rings, MOST_KNOWN), NEVER)
        self._digests = np.zeros((rings, MOST_KNOWN), np.int64)
        self._written = np.zeros(rings, np.int64)
        self._former = np.full(rings, -1)  # samples written when the clock was set back, or -1
        self._newest = np.full(V * PER_VALVE, NEVER)
        self._lead = np.full(V, NEVER)  # largest time less our monotonic time, ns
        self._at = np.zeros(V, np.int64)  # our monotonic time of the last change, ns

    def find(self, changes: DataChanges, now_s: float, waiting: Waiting) -> Found:
        """Return the steps in changes received at ``now_s`` (monotonic).

        ``waiting`` is the alignment's state, which knows more after a restart of the service.
        """
        valve = changes.item // PER_VALVE
        repeated = np.zeros(len(changes), np.bool_)
        rows = self._watched[valve].nonzero()[0]
        for v in np.unique(valve[rows][self._was_set_back(valve[rows])]).tolist():
            known = self._by_time(v)
            self._mark_repeated(v, changes, rows[valve[rows] == v], known, repeated)
        rows = rows[~repeated[rows]]
        if not len(rows):
            return Found([], repeated)
        item, time, now = changes.item[rows], changes.source_time[rows], round(now_s * 1e9)
        seen = waiting.order[:, SEEN : SEEN + PER_VALVE].ravel()
        before = np.where(self._newest == NEVER, seen, self._newest)
        highest = before.copy()
        np.maximum.at(highest, item, time)
        order = np.argsort(item, kind="stable")
        of, then = item[order], time[order]
        first = np.diff(of, prepend=-1) != 0
        previous = np.where(first, before[of], np.roll(then, 1))
        falls = (previous != NEVER) & (then < previous - self._reorder[of // PER_VALVE])
        present = np.unique(valve[rows])
        back = np.zeros(len(self._watched), np.bool_)
        back[of[falls] // PER_VALVE] = True
        top = highest.reshape(-1, PER_VALVE).max(axis=1)
        known_lead = self._lead != NEVER
        lead = self._lead - np.rint(_DRIFT * (now - self._at)).astype(np.int64)
        excess = np.where(known_lead, top - now - np.where(known_lead, lead, 0), 0)
        steps = []
        for v in present[(back | (excess > _AHEAD_NS))[present]].tolist():
            own = rows[valve[rows] == v]
            found = (
                self._set_back(v, changes, own, before, waiting.left[v])
                if back[v]
                else self._set_forward(v, changes, own, before, int(excess[v]))
            )
            if found is not None:
                steps.append(found)
                after = own[own >= found.row]
                span = slice(v * PER_VALVE, (v + 1) * PER_VALVE)
                if found.command == SET_BACK:
                    known = self._by_time(v)
                    earlier = self._samples(v, changes, own[own < found.row])
                    for then_t, digest in earlier.items():
                        known.setdefault(then_t, set()).add(digest)
                    self._mark_repeated(v, changes, after, known, repeated)
                    after = after[~repeated[after]]
                    highest[span] = NEVER
                    np.maximum.at(highest, changes.item[after], changes.source_time[after])
                    self._former[self._row[v]] = self._written[self._row[v]]
                lead[v] = NEVER
        self._newest = highest
        top = highest.reshape(-1, PER_VALVE).max(axis=1)
        fresh = ~known_lead | (lead == NEVER)
        new = top[present] - now
        self._lead[present] = np.where(fresh[present], new, np.maximum(lead[present], new))
        self._at[present] = now
        return Found(sorted(steps, key=lambda step: step.row), repeated)

    def remember(self, samples: ByValve) -> None:
        """Remember emitted samples, to recognise repetitions."""
        valves, starts, stops = samples.segments
        mine = self._watched[valves].nonzero()[0]
        if not len(mine):
            return
        columns = np.stack([getattr(samples.samples, name) for name in MEASURED], axis=1)
        for k in mine.tolist():
            row, v = self._row[valves[k]], int(valves[k])
            own = slice(max(starts[k], stops[k] - MOST_KNOWN), stops[k])
            n = own.stop - own.start
            at = (self._written[row] + np.arange(n)) % MOST_KNOWN
            self._times[row, at] = samples.samples.t[own]
            self._digests[row, at] = _digest(columns[own], self._required[v])
            self._written[row] += n

    def known(self, v: int) -> Known:
        """Return the samples by which a restarted service finds repetitions."""
        if not (self._watched[v] and self._was_set_back(np.array([v]))[0]):
            return _NOTHING_KNOWN
        row = self._row[v]
        latest = np.arange(max(0, self._written[row] - MOST_KNOWN), self._written[row])
        latest %= MOST_KNOWN
        return Known(self._times[row, latest], self._digests[row, latest])

    def put(self, v: int, known: Known) -> None:
        """Restore the result of `known`."""
        n = len(known.times)
        if not (self._watched[v] and n):
            return
        row = self._row[v]
        self._times[row, :n], self._digests[row, :n] = known
        self._written[row] = self._former[row] = n  # as if the clock was set back only now

    def _set_back(
        self, v: int, changes: DataChanges, own: NDArray[np.intp], before: Times, left: Times
    ) -> Step | None:
        """Return the step back at the first old time with new content.

        ``left`` are the times of emitted samples, also of those from before a restart.
        """
        highest = before[v * PER_VALVE : (v + 1) * PER_VALVE].tolist()
        signals, times = (changes.item[own] % PER_VALVE).tolist(), changes.source_time[own]
        known = self._by_time(v)
        repeated: set[int] = set()
        for k, (j, time) in enumerate(zip(signals, times.tolist(), strict=True)):
            if time >= highest[j] - int(self._reorder[v]):
                highest[j] = max(highest[j], time)
            elif time not in repeated:
                now = self._samples(v, changes, own[k:][times[k:] == time])
                then = self._samples(v, changes, own[:k][times[:k] == time])
                same = known.get(time) or set(then.values())
                if now and not same.issuperset(now.values()) and (same or time not in left):
                    return Step(v, int(own[k]), SET_BACK)
                repeated.add(time)
        return None

    def _was_set_back(self, valves: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Whether samples from before a step back of these watched valves' clocks are known."""
        row = self._row[valves]
        former = self._former[row]
        return np.asarray((former >= 0) & (self._written[row] - former < MOST_KNOWN))

    def _by_time(self, v: int) -> dict[int, set[int]]:
        """Return the digests by time of the samples that are remembered of one valve.

        A clock that was set back may show a time twice.
        """
        row = self._row[v]
        n = min(int(self._written[row]), MOST_KNOWN)
        found: dict[int, set[int]] = {}
        for time, digest in zip(
            self._times[row, :n].tolist(), self._digests[row, :n].tolist(), strict=True
        ):
            found.setdefault(time, set()).add(digest)
        return found

    def _mark_repeated(
        self,
        v: int,
        changes: DataChanges,
        own: NDArray[np.intp],
        known: dict[int, set[int]],
        repeated: NDArray[np.bool_],
    ) -> None:
        """Mark those rows of one valve whose samples are known, with the same content."""
        times = changes.source_time[own]
        for time in {time for time in times.tolist() if time in known}:
            same = own[times == time]
            if known[time] & {ANY, self._samples(v, changes, same).get(time)}:
                repeated[same] = True

    def _samples(self, v: int, changes: DataChanges, rows: NDArray[np.intp]) -> dict[int, int]:
        """Return the digest by time of the complete samples among these changes of one valve."""
        times, place = np.unique(changes.source_time[rows], return_inverse=True)
        values = np.full((len(times), SIGNALS), np.nan)
        there = np.zeros((len(times), SIGNALS), np.bool_)
        signal = changes.item[rows] % PER_VALVE
        measured = signal < SIGNALS
        values[place[measured], signal[measured]] = changes.value[rows][measured]
        there[place[measured], signal[measured]] = True
        whole = there[:, self._required[v]].all(axis=1)
        digests = _digest(values[whole], self._required[v])
        return dict(zip(times[whole].tolist(), digests.tolist(), strict=True))

    def _set_forward(
        self, v: int, changes: DataChanges, own: NDArray[np.intp], before: Times, excess: int
    ) -> Step | None:
        """Return the step forward at the largest gap, if that is no real time."""
        time = changes.source_time[own]
        highest = np.maximum.accumulate(time)
        known = before[v * PER_VALVE : (v + 1) * PER_VALVE].max()
        gaps = np.diff(np.maximum(highest, known), prepend=known)
        k = int(np.argmax(gaps))
        return Step(v, int(own[k]), SET_FORWARD) if gaps[k] > _SHARE * excess else None


def _digest(values: NDArray[np.float64], required: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Digest of each sample, (N, SIGNALS), over its required signals."""
    bits = np.ascontiguousarray(values).view(np.uint64) * _FACTORS
    bits ^= bits >> np.uint64(29)
    summed = np.where(required, bits, np.uint64(0)).sum(axis=1, dtype=np.uint64)
    return np.asarray(summed.view(np.int64))
