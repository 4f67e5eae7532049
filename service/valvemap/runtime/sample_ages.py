"""Ages of the valves' newest samples by the clocks of their sources."""

import numpy as np

from valvemap.clock import Clock
from valvemap.model.samples import Floats, Times
from valvemap.pipeline.sample_clocks import SampleClocks
from valvemap.pipeline.source_ports import AllSources


class SampleAges:
    """Times of the newest samples of M valves, against the present time of their sources."""

    def __init__(self, M: int, source: AllSources, clock: Clock) -> None:
        self._newest = np.zeros(M, np.int64)  # sample's time, UTC ns; 0: no sample yet
        self.clocks = SampleClocks(M)
        self._source, self._clock = source, clock

    def note(self, members: Times, newest: Times) -> None:
        """Note the times of the newest samples of the given valves, UTC ns."""
        self._newest[members] = newest
        if len(members):
            ours = self._against_ours(self._source.clock_offset_s)
            self.clocks.note(members, newest, self._clock.monotonic(), ours)

    def of(self, valves: slice = slice(None)) -> Floats:
        """Age of each valve's newest sample by the source's clock, s; NaN: no sample yet."""
        newest = self._newest[valves]
        ages = np.maximum((self.source_now()[valves] - newest) * 1e-9, 0.0)
        return np.where(newest > 0, ages, np.nan)

    def source_now(self) -> Times:
        """Current time of each valve's source, UTC ns."""
        offset_s = self._source.clock_offset_s
        self.clocks.note_offset(self._against_ours(offset_s))
        ahead = offset_s + self.clocks.correction_s
        return self._clock.now() + np.rint(ahead * 1e9).astype(np.int64)

    def _against_ours(self, offset_s: float | Floats) -> Floats:
        """Offset of each valve's source, given against our clock, against our monotonic time, s."""
        ours = self._clock.now() * 1e-9 - self._clock.monotonic()
        return np.add(offset_s, ours, out=np.empty(self._newest.shape))
