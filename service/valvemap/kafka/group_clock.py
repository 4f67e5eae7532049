"""Which samples are dated far ahead of their group's clock. Pure, and the same at a redelivery.

A single sample of the year 2116 would make all later samples of its valve late. The group's clock
is made of messages alone, never of the worker's clock:

- a sample that is no later than the message's own time in Kafka (plus ``AHEAD_NS``) is plausible:
  recordings may be sent years later, and sources may have been off for years;
- where the source's clock runs ahead of Kafka's, or Kafka's time is unknown, the clock is the
  newest sample that was taken, and a sample may be ``GAP_NS`` ahead of it; the first block of a
  group sets it, by the median of its samples, to at most ``UNSET_NS`` ahead of Kafka's time;
- where the medians of ``CONFIRMED`` blocks in a row are ahead, and agree, the source has been off
  for longer than that, or its clock was set: the last of them is taken, and the clock with it.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Times

AHEAD_NS: Final = 60_000_000_000  # ns; clocks of source and sender differ by less, or are not set
GAP_NS: Final = 3_600_000_000_000  # ns; no sample is lost by a pause that lasts less than an hour
UNSET_NS: Final = 366 * 86_400_000_000_000  # ns; clocks that were set, but not well, err by less
CONFIRMED: Final = 3  # blocks in a row; two may be a coincidence
LATEST_NS: Final = 2**62  # UTC ns; the difference of any two times still fits into 64 bits

Ahead = tuple[tuple[int, int], ...]  # of blocks that were ahead: number and median, UTC ns


def plausible(
    t: Times, number: int, newest: int, sent: int | None, ahead: Ahead
) -> tuple[NDArray[np.bool_], Ahead]:
    """Return which samples of a block are not ahead, and the blocks in a row that were.

    Parameters
    ----------
    t
        Of all samples of a block, UTC ns, (n,).
    number
        Of the block: a repeated block confirms nothing.
    newest
        Of the samples that were taken before, UTC ns; 0: none.
    sent
        Time of the message in Kafka, UTC ns; None: unknown.
    ahead
        As it was returned for the block before.

    Examples
    --------
    >>> t = np.array([5, 10**19 // 2, 6])
    >>> plausible(t, 1, 0, None, ())
    (array([ True, False,  True]), ())
    """
    if not len(t):
        return np.ones(0, np.bool_), ahead
    median = int(np.partition(t, (len(t) - 1) // 2)[(len(t) - 1) // 2])
    limit = _limit(median, newest, sent)
    if median > limit:
        ahead = _with(ahead, number, median)
        if len(ahead) >= CONFIRMED:
            limit, ahead = median + GAP_NS, ()
    else:
        ahead = ()
    return (t >= 0) & (t <= min(limit, LATEST_NS)), ahead


def _limit(median: int, newest: int, sent: int | None) -> int:
    clock = newest or max(0, min(median, LATEST_NS))
    if sent is None:
        return clock + GAP_NS
    if clock <= sent + AHEAD_NS:
        return sent + AHEAD_NS
    return (newest or min(clock, sent + UNSET_NS)) + GAP_NS


def _with(ahead: Ahead, number: int, median: int) -> Ahead:
    """With one block more; without those that it does not agree with, or that it repeats."""
    if ahead and not 0 <= median - ahead[-1][1] <= GAP_NS:
        return ((number, median),)
    return ahead if any(number <= known for known, _ in ahead) else (*ahead, (number, median))
