"""Ages of the valves' newest samples by the clocks of their sources."""

from typing import Final

import numpy as np

from valvemap.clock import Clock
from valvemap.model.samples import Floats, Times
from valvemap.pipeline.sample_clocks import SampleClocks
from valvemap.pipeline.source_ports import AllSources

SAME_S: Final = 1e-3  # s; a smaller move of our clock is no step: rounding, or its adjustment


class SampleAges:
    """Times of the newest samples of M valves, against the present time of their sources."""

    def __init__(self, M: int, source: AllSources, clock: Clock) -> None:
        self._newest = np.zeros(M, np.int64)  # sample's time, UTC ns; 0: no sample yet
        self.clocks = SampleClocks(M)
        self._source, self._clock = source, clock
        self._offset_s: float | Floats = np.nan  # of the sources, as noted last
        self._ours_s = np.nan  # our time of day against our monotonic time, as noted last
        self._corrected = -1  # changes of the clocks' corrections, as noted last
        self._ahead_ns = self._newest  # sources' clocks against ours, with corrections

    def note(self, members: Times, newest: Times) -> None:
        """Note the times of the newest samples of the given valves, UTC ns."""
        self._newest[members] = newest
        if len(members):
            offset_s = np.add(self._source.clock_offset_s, self._ours(), out=self._empty())
            self.clocks.note(members, newest, self._clock.monotonic(), offset_s)

    def of(self, valves: slice = slice(None)) -> Floats:
        """Age of each valve's newest sample by the source's clock, s; NaN: no sample yet."""
        newest = self._newest[valves]
        ages = np.maximum((self.source_now()[valves] - newest) * 1e-9, 0.0)
        return np.where(newest > 0, ages, np.nan)

    def source_now(self) -> Times:
        """Current time of each valve's source, UTC ns."""
        self._note_offsets()
        return self._clock.now() + self._ahead_ns

    def _note_offsets(self) -> None:
        """Note the present offsets; between two steps of any clock they stay as noted."""
        offset_s, ours_s = self._source.clock_offset_s, self._ours()
        is_known = offset_s is self._offset_s and abs(ours_s - self._ours_s) < SAME_S
        if is_known and self._corrected == self.clocks.changes:
            return
        self.clocks.note_offset(np.add(offset_s, ours_s, out=self._empty()))
        ahead_s = offset_s + self.clocks.correction_s
        self._ahead_ns = np.rint(ahead_s * 1e9).astype(np.int64)
        self._offset_s, self._ours_s = offset_s, ours_s
        self._corrected = self.clocks.changes

    def _ours(self) -> float:
        """Our time of day against our monotonic time, s."""
        return self._clock.now() * 1e-9 - self._clock.monotonic()

    def _empty(self) -> Floats:
        return np.empty(self._newest.shape)
