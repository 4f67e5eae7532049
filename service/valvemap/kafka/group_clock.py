"""Plausibility of sample times against the group's clock. Pure, and reproducible on redelivery.

A single sample dated 2116 would make all later samples of its valve late. The group's clock
depends on the messages alone, never on the worker's clock:

- A sample dated no later than the message's Kafka timestamp plus ``AHEAD_NS`` is plausible:
  recordings may be sent years later, and sources may have been off for years.
- If the source's clock is ahead of Kafka's, or Kafka's time is unknown, the clock is the newest
  accepted sample, and a sample may be up to ``GAP_NS`` ahead of it. The first block of a group
  sets the clock to the median of its samples, at most ``UNSET_NS`` ahead of Kafka's time.
- If the medians of ``CONFIRMED`` consecutive blocks are ahead and agree, the source was off for
  longer than ``GAP_NS``, or its clock was set. The last of these blocks is accepted and sets the
  clock.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Times

AHEAD_NS: Final = 60_000_000_000  # ns; clocks of source and sender that are set differ by less
GAP_NS: Final = 3_600_000_000_000  # ns; no sample is rejected after a pause of less than an hour
UNSET_NS: Final = 366 * 86_400_000_000_000  # ns; more than the error of a badly set clock
CONFIRMED: Final = 3  # consecutive blocks; two may be a coincidence
LATEST_NS: Final = 2**62  # UTC ns; the difference of any two times fits into 64 bits

Ahead = tuple[tuple[int, int], ...]  # blocks dated ahead: number and median, UTC ns


def plausible(
    t: Times, number: int, newest: int, sent: int | None, ahead: Ahead
) -> tuple[NDArray[np.bool_], Ahead]:
    """Return a mask of the plausible samples, and the consecutive blocks dated ahead.

    Parameters
    ----------
    t
        Times of a block's samples, UTC ns, (n,).
    number
        Number of the block; a repeated block confirms nothing.
    newest
        Time of the newest accepted sample, UTC ns; 0: none.
    sent
        Kafka timestamp of the message, UTC ns; None: unknown.
    ahead
        Returned for the previous block.

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
    """Append a block, unless it is repeated; start a new list if its median disagrees."""
    if ahead and not 0 <= median - ahead[-1][1] <= GAP_NS:
        return ((number, median),)
    return ahead if any(number <= known for known, _ in ahead) else (*ahead, (number, median))
