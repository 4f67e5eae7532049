"""The loop that groups one valve's changes into scans: all that a source wrote in one cycle.

A signal is written at most once in a scan, and a scan lasts no longer than ``window``. On-change
signals absent from a scan are held; signals stamped late are interpolated to the scan's first
instant, on-change signals where they come in successive scans.
"""

from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from valvemap.model.kernels.compiled import inner, kernel
from valvemap.vocabulary.signals import PER_VALVE

SIGNALS = PER_VALVE  # the running number is the last
NEVER = np.iinfo(np.int64).min
ZERO, ONE = cast("int", np.int64(0)), cast("int", np.int64(1))  # literals compile a callee again
_STEPS = 4  # periods; an older value is not used for interpolation

SIZE, NEWEST, LEFT, LATE, TWICE, FIELDS = range(6)  # of ``course``


class Scans(NamedTuple):
    """State of the scans of one valve.

    ``time``, ``signal``, ``value``, ``status`` (K,) are the buffered changes in the order of time;
    the first SIZE of ``course`` (FIELDS,) are in use. By signal, (SIGNALS,): ``now_value``,
    ``now_status``, ``now_time``, ``now_rate`` are the newest emitted value and its rate, per ns;
    ``seen`` is the newest time received, ``lacking`` and ``moved`` count scans that gave no sample
    because the signal was absent or moved too fast.
    """

    time: NDArray[np.int64]
    signal: NDArray[np.int64]
    value: NDArray[np.float64]
    status: NDArray[np.uint32]
    now_value: NDArray[np.float64]
    now_status: NDArray[np.uint32]
    now_time: NDArray[np.int64]
    now_rate: NDArray[np.float64]
    seen: NDArray[np.int64]
    lacking: NDArray[np.int64]
    moved: NDArray[np.int64]
    course: NDArray[np.int64]


class ScanRules(NamedTuple):
    """Detected timing of a valve's signals, (SIGNALS,) each; times in ns.

    ``there``: the valve has this signal. ``held``: it is written on change, or seldom. ``limit``:
    largest permitted move within its distance from the scan's first instant, or deviation from its
    previous rate; infinite: not interpolated. A held signal that moves more is taken as it is,
    another one makes no sample. ``jitter``: largest step due to noise.
    """

    there: NDArray[np.bool_]
    held: NDArray[np.bool_]
    limit: NDArray[np.float64]
    jitter: NDArray[np.float64]
    window: int
    period: int
    horizon: int
    max_wait: int


class Changed(NamedTuple):
    """Changes of one valve, (N,) each."""

    signal: NDArray[np.int64]
    value: NDArray[np.float64]
    status: NDArray[np.uint32]
    time: NDArray[np.int64]


@kernel
def make_scans(
    changes: Changed,
    flush: bool,  # noqa: FBT001 - numba takes positions only
    rules: ScanRules,
    w: Scans,
    out: Changed,
) -> int:
    """Process changes; write finished scans to ``out``; return the number of changes in it.

    All changes of a scan get one time. ``flush`` also writes unfinished scans, once the changes are
    processed.
    """
    n = ZERO
    for i in range(len(changes.time)):
        j, time = changes.signal[i], changes.time[i]
        if time == w.seen[j]:
            w.course[TWICE] += 1
            continue
        if w.seen[j] != NEVER and time < w.seen[j] - rules.max_wait:
            _begin_anew(w)
        w.seen[j] = max(w.seen[j], time)
        if w.course[LEFT] != NEVER and time <= w.course[LEFT]:
            w.course[LATE] += 1
            if time > w.now_time[j]:
                w.now_value[j], w.now_status[j] = changes.value[i], changes.status[i]
                w.now_time[j] = time
            continue
        if _waits_already(w, j, time):
            w.course[TWICE] += 1
            continue
        if w.course[SIZE] == len(w.time):
            n = _leave(rules, w, out, n, ONE)
        _insert(w, j, time, changes.value[i], changes.status[i])
        w.course[NEWEST] = max(w.course[NEWEST], time)
        n = _leave(rules, w, out, n, ZERO)
    if flush:
        n = _leave(rules, w, out, n, len(w.time) * ONE)
    return n


@inner
def _begin_anew(w: Scans) -> None:
    """Drop the buffer after a backward step of the source's clock: its scans stay incomplete."""
    w.course[SIZE] = 0
    w.course[NEWEST] = w.course[LEFT] = NEVER
    for j in range(SIGNALS):
        w.seen[j] = NEVER
        w.now_time[j] = NEVER if w.now_time[j] == NEVER else NEVER + 1


@inner
def _waits_already(w: Scans, j: int, time: int) -> bool:
    for k in range(w.course[SIZE] - 1, -1, -1):
        if w.time[k] == time and w.signal[k] == j:
            return True
        if w.time[k] < time:
            break
    return False


@inner
def _insert(w: Scans, j: int, time: int, value: float, status: int) -> None:
    """Insert a change after those with its time."""
    k = w.course[SIZE]
    while k > 0 and w.time[k - 1] > time:
        w.time[k], w.signal[k] = w.time[k - 1], w.signal[k - 1]
        w.value[k], w.status[k] = w.value[k - 1], w.status[k - 1]
        k -= 1
    w.time[k], w.signal[k], w.value[k], w.status[k] = time, j, value, status
    w.course[SIZE] += 1


@inner
def _leave(rules: ScanRules, w: Scans, out: Changed, n: int, forced: int) -> int:
    """Emit finished scans, and ``forced`` others; return the number of changes in ``out``."""
    while w.course[SIZE] > 0:
        size, found = _members(rules, w)
        if not _is_finished(rules, w, found):
            if forced == 0:
                break
            forced -= 1
        n = _emit(rules, w, size, found, out, n)
        w.course[LEFT] = w.time[size - 1]
        for k in range(size, w.course[SIZE]):
            w.time[k - size], w.signal[k - size] = w.time[k], w.signal[k]
            w.value[k - size], w.status[k - size] = w.value[k], w.status[k]
        w.course[SIZE] -= size
    return n


@inner
def _members(rules: ScanRules, w: Scans) -> tuple[int, int]:
    """Return the number of buffered changes in the first scan, and a bit for each signal."""
    found = 0
    for k in range(w.course[SIZE]):
        bit = 1 << w.signal[k]
        if w.time[k] - w.time[0] > rules.window or found & bit:
            return k, found
        found |= bit
    return w.course[SIZE], found


@inner
def _is_finished(rules: ScanRules, w: Scans, found: int) -> bool:
    """Whether no absent signal can still arrive for the first scan: each signal is in order."""
    ends = w.time[0] + rules.window
    for j in range(SIGNALS):
        absent = rules.there[j] and not found & (1 << j)
        if absent and w.seen[j] <= ends and w.course[NEWEST] < ends + rules.horizon:
            return False
    return True


@inner
def _emit(rules: ScanRules, w: Scans, size: int, found: int, out: Changed, n: int) -> int:
    """Emit the first scan, if it gives a sample; its values become the newest."""
    instant, first, made = w.time[0], n, True
    started = True
    for j in range(SIGNALS):
        started &= not rules.there[j] or w.now_time[j] != NEVER or bool(found & (1 << j))
    for j in range(SIGNALS):
        if rules.there[j] and not found & (1 << j):
            if not (rules.held[j] and w.now_time[j] != NEVER):
                made = False
                w.lacking[j] += started
            elif made:
                out.signal[n], out.time[n] = j, instant
                out.value[n], out.status[n] = w.now_value[j], w.now_status[j]
                n += 1
    for k in range(size):
        j, time, value, status = w.signal[k], w.time[k], w.value[k], w.status[k]
        before, late = w.now_time[j], np.float64(time - instant)
        if time > instant and np.isfinite(rules.limit[j]):
            near = before > NEVER + 1 and time - before <= _STEPS * rules.period
            rate, drift = np.inf, np.inf
            if near:
                rate = (value - w.now_value[j]) / np.float64(time - before)
                status = max(status, w.now_status[j])
                noisy = rules.jitter[j] / np.float64(time - before)
                drift = (min(abs(rate), abs(rate - w.now_rate[j])) - noisy) * late
            if drift <= rules.limit[j]:
                value -= rate * late
            elif not (rules.held[j] or np.isnan(value) or np.isnan(w.now_value[j])):
                w.moved[j] += made and before != NEVER
                made = False
        if made:
            out.signal[n], out.time[n] = j, instant
            out.value[n], out.status[n] = value, status
            n += 1
    for k in range(size):
        j = w.signal[k]
        before = w.now_time[j]
        if before > NEVER + 1 and w.time[k] > before:
            rate = (w.value[k] - w.now_value[j]) / np.float64(w.time[k] - before)
            w.now_rate[j] = rate if np.isfinite(rate) else np.inf
        w.now_value[j], w.now_status[j], w.now_time[j] = w.value[k], w.status[k], w.time[k]
    return n if made else first
