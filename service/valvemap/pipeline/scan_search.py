"""Detection of how a source stamps a valve's signals, from their first changes. Pure.

A source may give all signals of a scan the same timestamp, stagger them, or write a signal only on
change. No signal is written twice in a scan. So the shortest usual step of the fastest signal is
the scan's period, and changes within half a period belong to one scan.
"""

from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Floats, Times
from valvemap.pipeline.kernels.scans import NEVER, Changed
from valvemap.vocabulary.signals import PER_VALVE, SENSORS, Signal

FEWEST_SCANS: Final = 4  # scans; with fewer nothing is detected
OFTEN: Final = 0.98  # share of scans that contain a signal; below, it is written on change
ALIKE: Final = 0.5  # least share of scans with one timestamp, for a source that stamps so …
BESIDE: Final = 0.1  # … and largest share of complete but staggered scans
SPREAD_MARGIN: Final = 1.5  # ratio of the window to the 98 % quantile of the scans' duration
SHORTEST_WINDOW_NS: Final = 2_000_000  # stamps in ms differ by one within an instant
HALF_THE_NOISE: Final = 0.5  # of the noise; tolerated move within the offset of a signal …
RESOLUTION: Final = 1e-3  # … or this share of its range, without noise
STEPS_OF_NOISE: Final = 5.0  # standard deviations; longer steps are not noise alone
CLEARLY: Final = 0.9  # ratio of misfits below which signals are used without interpolation
STEPS_OF_A_DEADBAND: Final = 8  # steps; with fewer no deadband is detected
ABOUT_AS_SMALL: Final = 2.0  # times the smallest step; steps within this are of the deadband …
MOST_STEPS: Final = 0.5  # … if at least this share of all steps is
SENT_AGAIN: Final = 3  # values; fewer may have been sent again after a new connection
_MEASURED: Final = tuple(s for s in SENSORS if s is not Signal.U)  # U is a command: no deadband
_ENOUGH: Final = 24  # scans; with fewer the flow is not compared
_TINY: Final = 1e-12
_NOISE_OF_SECOND_DIFFERENCES: Final = 0.6745 * 6.0**0.5  # their median, for unit white noise


class Comes(IntEnum):
    """How one signal is stamped."""

    ABSENT = 0  # the valve has none
    WITH_THE_SCAN = 1
    INTERPOLATED = 2
    AS_IT_IS = 3  # stamped late, but measured at the scan's first instant, as the flow shows
    HELD = 4


@dataclass(frozen=True)
class Found:
    """Timing of the signals of one valve; arrays (6,), times in ns.

    ``comes`` holds a :class:`Comes` for each signal, ``offset`` its usual delay after the first
    stamp of its scan, ``limit`` the largest move within that for interpolation, ``jitter`` the
    largest step between scans due to noise, both in the signal's unit. A held signal is
    interpolated too where it comes in successive scans. ``deadband`` is that of a
    measured on-change signal; 0: none detected.
    """

    comes: NDArray[np.int64]
    offset: Times
    limit: Floats
    jitter: Floats
    period: int
    window: int
    deadband: Floats = field(default_factory=lambda: np.zeros(PER_VALVE))


NOT_FOUND: Final = Found(
    comes=np.zeros(PER_VALVE, np.int64),
    offset=np.zeros(PER_VALVE, np.int64),
    limit=np.zeros(PER_VALVE),
    jitter=np.zeros(PER_VALVE),
    period=0,
    window=0,
)


def is_stamped_alike(changes: Changed, there: NDArray[np.bool_]) -> bool:
    """Whether the signals of a sample have one timestamp, as far as these changes show."""
    scans = _scans(changes, there)
    if scans is None:
        return False
    times, _ = scans
    newest = min(changes.time[changes.signal == j].max() for j in np.flatnonzero(there))
    own = times[:, there]
    own = own[np.where(own == NEVER, np.iinfo(np.int64).max, own).min(axis=1) <= newest]
    whole = (own != NEVER).all(axis=1)
    alike = whole & (own == own[:, :1]).all(axis=1)
    n = max(len(own), 1)
    return bool(alike.sum() >= ALIKE * n and (whole & ~alike).sum() <= BESIDE * n)


def only_changes(changes: Changed, signal: int) -> bool:
    """Whether the source was never seen to send a signal's value again unchanged."""
    own = changes.signal == signal
    x = changes.value[own][np.argsort(changes.time[own], kind="stable")]
    return bool((np.diff(x) == 0.0).sum() < SENT_AGAIN)


def find_scans(changes: Changed, there: NDArray[np.bool_]) -> Found | None:
    """Detect the timing of signals with several timestamps; None: too few changes.

    Parameters
    ----------
    changes
        Changes of one valve, in the order of their arrival.
    there : (6,)
        Mask of the valve's signals.
    """
    scans = _scans(changes, there)
    if scans is None:
        return None
    times, values = scans[0][1:-1], scans[1][1:-1]  # the first and the last may be incomplete
    if len(times) < FEWEST_SCANS:
        return None
    has = times != NEVER
    first = np.where(has, times, np.iinfo(np.int64).max).min(axis=1)
    behind = np.where(has, times - first[:, None], 0)
    period = _period(changes)
    spread = float(np.quantile(behind.max(axis=1), OFTEN))
    window = int(np.clip(SPREAD_MARGIN * spread, min(SHORTEST_WINDOW_NS, period / 4), period / 2))
    comes = np.where(there, np.int64(Comes.WITH_THE_SCAN), np.int64(Comes.ABSENT))
    comes[there & (has.mean(axis=0) < OFTEN)] = Comes.HELD
    offset = np.zeros(PER_VALVE, np.int64)
    limit = np.full(PER_VALVE, np.inf)
    jitter = np.zeros(PER_VALVE)
    base = np.array([_first_value(changes, j) for j in range(PER_VALVE)])
    shifted, fast = values.copy(), np.zeros(len(values), np.bool_)
    fast[0] = True
    for j in np.flatnonzero(there & has.any(axis=0)):
        rows = np.flatnonzero(has[:, j])
        late = behind[rows, j]
        offset[j] = int(np.median(late))
        if (
            offset[j] < (SHORTEST_WINDOW_NS if comes[j] == Comes.HELD else 1)
            or j == Signal.SEQUENCE
        ):
            continue
        x = values[rows, j]
        noise = _noise(x)
        jitter[j] = STEPS_OF_NOISE * noise
        limit[j] = max(HALF_THE_NOISE * noise, RESOLUTION * float(np.ptp(x)))
        if comes[j] != Comes.HELD:
            comes[j] = Comes.INTERPOLATED
        rate = np.diff(x) / np.diff(times[rows, j])
        other = np.abs(np.diff(rate, prepend=np.inf))
        shifted[rows[1:], j] -= rate * late[1:]
        noisy = jitter[j] / np.diff(times[rows, j])
        fast[rows[1:]] |= (np.minimum(np.abs(rate), other) - noisy) * late[1:] > limit[j]
    if _are_of_one_instant(values, shifted, base, fast):
        comes[comes == Comes.INTERPOLATED] = Comes.AS_IT_IS
        limit[:] = np.inf
    deadband = np.array(
        [
            _deadband(changes, j) if comes[j] == Comes.HELD and j in _MEASURED else 0.0
            for j in range(PER_VALVE)
        ]
    )
    return Found(comes, offset, limit, jitter, period, window, deadband)


def _deadband(changes: Changed, j: int) -> float:
    """Return the smallest step of a signal if most steps are about as small, else 0."""
    own = changes.signal == j
    x = changes.value[own][np.argsort(changes.time[own], kind="stable")]
    steps = np.abs(np.diff(x))
    steps = steps[np.isfinite(steps) & (steps > 0.0)]
    if len(steps) < STEPS_OF_A_DEADBAND:
        return 0.0
    least = float(steps.min())
    return least if (steps <= ABOUT_AS_SMALL * least).mean() >= MOST_STEPS else 0.0


def _scans(changes: Changed, there: NDArray[np.bool_]) -> tuple[Times, Floats] | None:
    """Times and values (S, 6) of S scans; the time of an absent signal is NEVER."""
    for j in np.flatnonzero(there):
        if not (changes.signal == j).any():
            return None
    if (period := _period(changes)) == 0:
        return None
    order = np.argsort(changes.time, kind="stable")
    signal, time = changes.signal[order].tolist(), changes.time[order].tolist()
    rows, row, start, present = [], -1, 0, 0
    for j, t in zip(signal, time, strict=True):
        if row < 0 or t - start > period // 2 or present >> j & 1:
            row, start, present = row + 1, t, 0
        present |= 1 << j
        rows.append(row)
    times = np.full((row + 1, PER_VALVE), NEVER)
    values = np.full((row + 1, PER_VALVE), np.nan)
    times[rows, signal] = time
    values[rows, signal] = changes.value[order]
    began = _began(changes)
    recent = times.max(axis=1) >= began
    return times[recent], values[recent]


def _began(changes: Changed) -> int:
    """Time of the first change after initial values, which may be arbitrarily old."""
    starts = []
    for j in range(PER_VALVE):
        own = np.unique(changes.time[changes.signal == j])
        if len(own) > 1:
            starts.append(int(own[1]))
    return min(starts, default=NEVER)


def _period(changes: Changed) -> int:
    """Shortest usual step of the most frequent signal, ns; 0: unknown."""
    steps = []
    for j in range(PER_VALVE):
        own = np.unique(changes.time[changes.signal == j])[1:]
        if len(own) > FEWEST_SCANS:
            steps.append(float(np.quantile(np.diff(own), 0.1)))
    return int(min(steps, default=0.0))


def _are_of_one_instant(
    values: Floats, shifted: Floats, base: Floats, fast: NDArray[np.bool_]
) -> bool:
    """Whether the flow fits the signals better as they are than interpolated."""
    slow = ~fast if (~fast).sum() >= _ENOUGH else np.arange(len(fast)) > 0
    as_they_are, otherwise = (_misfit(_filled(x, base)[slow]) for x in (values, shifted))
    return bool(as_they_are < CLEARLY * otherwise)


def _filled(values: Floats, base: Floats) -> Floats:
    """Fill absent values with the signal's last value."""
    filled = np.concatenate([base[None], values])
    for k in range(1, len(filled)):
        filled[k] = np.where(np.isnan(filled[k]), filled[k - 1], filled[k])
    return filled[1:]


def _misfit(values: Floats) -> float:
    """Sum of squares of Q's fit by a smooth function of U and dp, (l/min)²; 0: too few scans."""
    U, p1, p2, Q = (values[:, j] for j in (Signal.U, Signal.P1, Signal.P2, Signal.Q))
    s = np.sqrt(np.maximum(p1 - p2, 0.0))
    X = np.stack([np.ones_like(U), U, s, U * s, U * U * s, s * s], axis=1)
    good = np.isfinite(X).all(axis=1) & np.isfinite(Q)
    if good.sum() < _ENOUGH:
        return 0.0
    X, Q = X[good] / np.maximum(np.abs(X[good]).max(axis=0), _TINY), Q[good]
    theta = np.linalg.lstsq(X, Q, rcond=1e-9)[0]
    return float(np.square(Q - X @ theta).sum())


def _first_value(changes: Changed, signal: int) -> float:
    own = changes.value[changes.signal == signal]
    return float(own[0]) if len(own) else np.nan


def _noise(x: Floats) -> float:
    """Standard deviation of the white noise in ``x``, from its second differences."""
    second = np.abs(np.diff(x[np.isfinite(x)], n=2))
    return float(np.median(second)) / _NOISE_OF_SECOND_DIFFERENCES if len(second) else 0.0
