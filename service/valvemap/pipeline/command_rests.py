"""Commands that moved in every sample, then rest at a source that sends on change alone. Pure.

While the signals of a valve have one timestamp, a U that is not sent leaves samples that lack it.
U is a command: it rests exactly, and is then held from change to change, unless the source was seen
to send it unchanged.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Times
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.kernels.waiting import FILLED, NEVER, SEEN, SIZE, TIME, Waiting
from valvemap.pipeline.scan_search import FEWEST_SCANS, SENT_AGAIN
from valvemap.vocabulary.signals import PER_VALVE, Signal

_BAD = 2  # quality of a sample


class Rest(NamedTuple):
    """``changes``: U as it was, for each sample that lacks it alone.

    ``held``: valve, U, time of the newest such sample (UTC ns), period (ns).
    """

    changes: DataChanges
    held: tuple[int, float, int, int]


class CommandRests:
    """Watches the commands of V valves, whose samples need the signals ``required`` (V, SIGNALS).

    A command rests once ``horizon_ns`` of samples, and at least four, lack it alone at the end of a
    batch. Of a sample that is Bad, U is not known.
    """

    def __init__(self, required: NDArray[np.bool_], horizon_ns: int) -> None:
        bits = np.int64(1) << np.arange(required.shape[1])
        self._others = ((required * bits).sum(axis=1)) & ~np.int64(1 << Signal.U)
        self._has_command = required[:, Signal.U]
        self._every = self._others | np.int64(1 << Signal.U)
        self._horizon_ns = horizon_ns
        self._repeats = np.zeros(len(required), np.int64)

    def note(self, samples: ByValve, waiting: Waiting) -> None:
        """Note the newest U of each valve, and how often one was sent again unchanged."""
        members, starts, stops = samples.segments
        if not len(members):
            return
        U, t, before = samples.samples.U, samples.samples.t, waiting.held_time[:, Signal.U]
        again = np.zeros(len(U), np.int64)
        again[1:] = U[1:] == U[:-1]
        again[starts] = U[starts] == waiting.held_value[members, Signal.U]
        again[starts] &= before[members] != NEVER
        self._repeats[members] += np.add.reduceat(again, starts)
        own = self._has_command[members]
        members, last = members[own], stops[own] - 1
        is_bad = samples.samples.quality[last] == _BAD
        waiting.held_value[members, Signal.U] = U[last]
        waiting.held_time[members, Signal.U] = np.where(is_bad, NEVER, t[last])

    def find(self, waiting: Waiting, watched: NDArray[np.bool_]) -> Iterator[Rest]:
        """Yield the commands of the ``watched`` valves (V,) that have come to rest."""
        may = watched & self._has_command & (self._repeats < SENT_AGAIN)
        may &= waiting.order[:, SIZE] >= FEWEST_SCANS
        for valve in np.flatnonzero(may).tolist():
            times = self._lacking(waiting, valve)
            held_time = int(waiting.held_time[valve, Signal.U])
            if len(times) and held_time != NEVER and held_time < times[0]:
                yield self._rest(valve, float(waiting.held_value[valve, Signal.U]), times)

    def _lacking(self, waiting: Waiting, valve: int) -> Times:
        """Return the times of the waiting samples if all lack U alone, for long enough."""
        slots = waiting.slots[valve, : waiting.order[valve, SIZE]]
        times = np.sort(slots[:, TIME])
        all_alike = bool((slots[:, FILLED] & self._every[valve] == self._others[valve]).all())
        since = int(waiting.order[valve, SEEN + Signal.U])
        if all_alike and since < times[0] and times[-1] - times[0] >= self._horizon_ns:
            return times
        return times[:0]

    def _rest(self, valve: int, U: float, times: Times) -> Rest:
        item = np.full(len(times), valve * PER_VALVE + Signal.U, np.int32)
        good = np.zeros(len(times), np.uint32)
        period = int(np.median(np.diff(times)))
        return Rest(
            DataChanges(item, np.full(len(times), U), good, times),
            (valve, U, int(times[-1]), period),
        )
