"""The statistics that a valve's alarms are judged by: usual residuals, and lost samples. Pure."""

import numpy as np

from valvemap.model.samples import Flags, Floats, Times
from valvemap.pipeline.kernels import alarm_layout as layout
from valvemap.pipeline.kernels.alarm_layout import Senses
from valvemap.vocabulary.signals import COUNT

LOSS_MEMORY_S = 60.0  # s; time constant of the share of lost samples
ENOUGH_SAMPLES = 100.0  # samples, lost or not; with fewer the share is not judged
SHOWN_BEFORE_NS, SHOWN_WITHIN_NS = 1_000_000_000, 20_000_000_000  # ns; window of confirmation
CLEAR_CHANGE = 2.5  # times the usual residual; a smaller change is one of the map
LAG_MOVED_S, LAG_MOVED_SHARE = 0.004, 0.15  # s, and share; a larger move changes the residuals

LOSSES = [layout.LOST, layout.TAKEN, layout.LOST_BEFORE, layout.TAKEN_BEFORE]
"""Of `Senses.memory`: what is counted of lost samples."""


def nothing_seen(M: int) -> Senses:
    """Return the statistics of M valves before the first sample."""
    signals, places = (M, COUNT), (M, layout.CELLS_U * layout.CELLS_S)
    memory = np.zeros((M, layout.MEMORY))
    memory[:, layout.CELL] = -1.0
    memory[:, [layout.T_USUAL, layout.Q_BEFORE]] = np.nan
    sums = layout.DIRECTIONS + 1
    return Senses(
        last=np.full(signals, np.nan),
        still=np.zeros(signals, np.int64),
        longest=np.zeros(signals, np.int64),
        moves=np.zeros(signals, np.int64),
        others=np.zeros(signals, np.int64),
        weight=np.zeros(places, np.float32),
        bias=np.zeros(places, np.float32),
        square=np.zeros(places, np.float32),
        sums=np.zeros((M, sums, sums)),
        memory=memory,
        times=np.full((M, layout.TIMES), layout.NEVER),
    )


def forget_usual(senses: Senses, m: int) -> None:
    """Reset the usual residuals of one valve."""
    fresh = nothing_seen(1)
    kept = [layout.T_USUAL, layout.CHANGES_SEEN, layout.LAG_BEFORE, *LOSSES]
    fresh.memory[0, kept] = senses.memory[m, kept]
    for name in ("memory", "weight", "bias", "square", "sums"):
        getattr(senses, name)[m] = getattr(fresh, name)[0]


def is_shown(senses: Senses, chosen: Times, t: Times, size: Floats) -> Flags:
    """Whether residuals of K valves confirm changes of the flow at ``t`` of this size (K,)."""
    memory, times = senses.memory, senses.times[chosen]
    shown = times[:, layout.LARGE_UNTIL] >= t - SHOWN_BEFORE_NS
    shown &= times[:, layout.LARGE_SINCE] <= t + SHOWN_WITHIN_NS
    shown &= size**2 >= CLEAR_CHANGE**2 * memory[chosen, layout.USUAL_SQUARE]
    return np.asarray(shown)


def have_moved(senses: Senses, chosen: Times, lags: Floats) -> Flags:
    """Note the lags of K valves, s; return whether each differs much from the one before."""
    before = senses.memory[chosen, layout.LAG_BEFORE]
    moved = np.abs(lags - before) > np.maximum(LAG_MOVED_S, LAG_MOVED_SHARE * before)
    senses.memory[chosen, layout.LAG_BEFORE] = lags
    return np.asarray(moved)


def share_lost(senses: Senses, chosen: Times, lost: Times, taken: Times) -> Floats:
    """Note the numbers of lost and accepted samples of K valves since the start.

    Return the recent share of lost ones, % (K,).
    """
    memory, times = senses.memory[chosen], senses.times[chosen]
    now, before = times[:, layout.NEWEST], times[:, layout.LOSS_TIME]
    first = before == layout.NEVER
    before = np.where(first, now, before)
    share = np.exp(-np.clip((now - before) * 1e-9, 0.0, 1e6) / LOSS_MEMORY_S)
    for sum_, last, count in (
        (layout.LOST, layout.LOST_BEFORE, lost),
        (layout.TAKEN, layout.TAKEN_BEFORE, taken),
    ):
        new = np.where(first, 0.0, np.maximum(count - memory[:, last], 0.0))
        memory[:, sum_] = share * memory[:, sum_] + new
        memory[:, last] = count
    senses.memory[chosen] = memory
    senses.times[chosen, layout.LOSS_TIME] = now
    total = memory[:, layout.LOST] + memory[:, layout.TAKEN]
    known = total >= ENOUGH_SAMPLES
    return np.where(known, 100.0 * memory[:, layout.LOST] / np.maximum(total, 1.0), 0.0)
