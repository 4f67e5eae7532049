"""Which axes are connected, how old their newest samples are, and whether silence is a loss."""

from collections.abc import Sequence

import numpy as np

from valvemap.clock import Clock
from valvemap.model.samples import Times
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.axes import Axis
from valvemap.pipeline.axis_arrivals import LINES
from valvemap.pipeline.source_ports import AllSources


class HeardAxes:
    """Connections and silence of K axes, whose lines are rows `LINES`·k and the next of the source.

    Parameters
    ----------
    axes
        The axes.
    arrivals
        Knows how the signals of the rows are stamped.
    source
        Knows how far its clocks are ahead of ours.
    clock
        Clock.

    Attributes
    ----------
    connected : bool
        Mask of the rows whose source is connected, (LINES·K,).
    """

    def __init__(
        self, axes: Sequence[Axis], arrivals: Arrivals, source: AllSources, clock: Clock
    ) -> None:
        self.connected = np.zeros(LINES * len(axes), np.bool_)
        self._axes, self._arrivals, self._source, self._clock = axes, arrivals, source, clock
        self._heard_at = np.full(len(axes), -np.inf)
        self._began_at = np.nan  # when the first connection was made, or failed

    def rows(self, valves: Times | None) -> Times:
        """Return the given rows, or (None) all."""
        return np.arange(len(self.connected)) if valves is None else valves

    def begin(self) -> None:
        """Note that a connection was made, or failed: from the first one on, silence counts."""
        if np.isnan(self._began_at):
            self._began_at = self._clock.monotonic()

    def note_sample(self, number: int) -> None:
        """Note that a whole sample of an axis has come now."""
        self._heard_at[number] = self._clock.monotonic()

    def age_s(self, number: int) -> float | None:
        """Age of the newest sample, by its arrival and by the clocks, s; None: not connected."""
        first = LINES * number
        if not self.connected[first : first + LINES].all():
            return None
        offsets = np.broadcast_to(self._source.clock_offset_s, self.connected.shape)
        behind = 1e-9 * (self._clock.now() - self._axes[number].t) + float(offsets[first])
        return max(self._clock.monotonic() - float(self._heard_at[number]), behind)

    def silent_s(self, number: int, now: float) -> float:
        """Time without a sample of an axis, s, at ``now`` (monotonic); 0 while it may rest.

        A source that sends on change alone is silent while no value changes.
        """
        if self._may_rest(number):
            return 0.0
        return now - max(self._began_at, float(self._heard_at[number]))

    def is_stale(self, number: int, now: float, after_s: float) -> bool:
        """Whether an axis was never heard, or sent no sample for ``after_s`` and may not rest."""
        heard_at = float(self._heard_at[number])
        may_rest = self._may_rest(number) and np.isfinite(heard_at)
        return now - heard_at > after_s and not may_rest

    def _may_rest(self, number: int) -> bool:
        rows = np.arange(LINES * number, LINES * (number + 1))
        return bool(self.connected[rows].all()) and self._arrivals.timing.may_rest(rows)
