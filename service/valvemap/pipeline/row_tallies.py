"""Missing numbers and gaps in the samples of recordings, by valve; a line for each."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from valvemap.model.samples import Samples
from valvemap.vocabulary.signals import MEASURED

GAP: Final = 5.0  # times the usual step
_USUAL_OF: Final = 1_000  # first steps, whose median is the usual one


@dataclass
class _Tally:
    rows: int = 0
    missing: dict[str, int] = field(default_factory=dict)
    last: int | None = None
    usual: float = 0.0
    gaps: int = 0
    longest: float = 0.0
    at: int = 0


class RowTallies:
    """Counts over all batches of a replay.

    Examples
    --------
    >>> tallies = RowTallies()
    >>> t = np.r_[0:50, 80:100] * 10**8
    >>> U = np.where(np.arange(70) == 3, np.nan, 50.0)
    >>> tallies.count("V", Samples.of(t=t, U=U, p1=U + 100, p2=U * 0 + 5, Q=U))
    >>> print(*tallies.lines(), sep=chr(10))
    V: no number in U 1, p1 1, p2 1, Q 1 of 70 rows
    V: gaps: 1 longer than 0.5 s, the longest 3.1 s at 4.9 s
    """

    def __init__(self) -> None:
        self._tallies: dict[str, _Tally] = {}

    def count(self, valve: str, samples: Samples) -> None:
        """Add a batch of a valve's samples, in the order of the file."""
        if not len(samples):
            return
        own = self._tallies.setdefault(valve, _Tally())
        own.rows += len(samples)
        for name in MEASURED:
            n = int(np.isnan(getattr(samples, name)).sum())
            own.missing[name] = own.missing.get(name, 0) + n
        t = samples.t if own.last is None else np.concatenate([[own.last], samples.t])
        own.last = int(samples.t[-1])
        steps = np.diff(t)
        if not own.usual and len(steps):
            positive = steps[:_USUAL_OF][steps[:_USUAL_OF] > 0]
            own.usual = float(np.median(positive)) if len(positive) else 0.0
        long = np.flatnonzero(steps > GAP * own.usual) if own.usual else np.zeros(0, np.intp)
        own.gaps += len(long)
        if len(long) and steps[long].max() > own.longest:
            place = long[np.argmax(steps[long])]
            own.longest, own.at = float(steps[place]), int(t[place])

    def lines(self) -> Iterator[str]:
        """Yield a line for each valve with missing numbers, and one for each with gaps."""
        for valve, own in self._tallies.items():
            missing = {
                n: k for n, k in own.missing.items() if k and not (n == "T" and k == own.rows)
            }
            if missing:
                counts = ", ".join(f"{name} {n:,}" for name, n in missing.items())
                yield f"{valve}: no number in {counts} of {own.rows:,} rows"
            if own.gaps:
                yield (
                    f"{valve}: gaps: {own.gaps:,} longer than {GAP * own.usual * 1e-9:.3g} s, the "
                    f"longest {own.longest * 1e-9:.3g} s at {own.at * 1e-9:.10g} s"
                )
