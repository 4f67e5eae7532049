"""The newest minutes of an axis' movement, batch by batch: what a search is over."""

from collections import deque

import numpy as np

from valvemap.model.axis import AxisSamples


class AxisWindow:
    """A bounded queue of batches; the oldest are dropped. Its cost is that of the newest batch.

    Parameters
    ----------
    longest_s
        Movement that is kept, s.
    most_samples
        Samples that are kept, if they come very quickly.
    """

    def __init__(self, longest_s: float, most_samples: int) -> None:
        self._longest_s, self._most_samples = longest_s, most_samples
        self._batches: deque[tuple[float, AxisSamples]] = deque()  # s of movement, and its samples
        self._length_s, self._samples = 0.0, 0

    def __len__(self) -> int:
        return self._samples

    def append(self, passed_s: float, samples: AxisSamples) -> None:
        """Append a batch with ``passed_s`` seconds of movement; at least the newest batch stays."""
        self._batches.append((passed_s, samples))
        self._length_s += passed_s
        self._samples += len(samples)
        while len(self._batches) > 1 and (
            self._length_s > self._longest_s or self._samples > self._most_samples
        ):
            oldest_s, oldest = self._batches.popleft()
            self._length_s -= oldest_s
            self._samples -= len(oldest)

    def clear(self) -> None:
        """Drop all batches."""
        self._batches.clear()
        self._length_s, self._samples = 0.0, 0

    def whole(self) -> AxisSamples:
        """Return all samples as one batch; there must be one."""
        batches = [samples for _, samples in self._batches]
        names = [name for name in vars(batches[0]) if name != "t"]
        return AxisSamples.of(
            np.concatenate([batch.t for batch in batches]),
            **{name: np.concatenate([getattr(batch, name) for batch in batches]) for name in names},
        )
