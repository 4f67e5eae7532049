"""Numbers that stand for no reading: -999, 0 or 9999 in single samples of a signal.

A logger or historian writes such a number where a value is missing. In the samples it is one exact
value that a signal jumps to and back from, again and again, while the others continue as before.
"""

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_OFTEN: Final = 10  # jumps to the same number; chance and spikes of a line do not repeat so often
_RARE: Final = 0.4  # share of the samples; a number that is there more often is a reading
_BACK: Final = 0.25  # of the jump: so near are the samples before and after
_FAR: Final = 0.25  # of the signal's usual span; a smaller jump is noise
_STEPS: Final = 8.0  # least distances of two readings; a smaller jump is that of a coarse meter
_GOES_ON: Final = 0.1  # of the usual span of another signal, which does not notice
_USUAL: Final = (5.0, 95.0)  # % of the values, of the usual span
_LONGEST: Final = 2  # samples of a jump
_TWO: Final = 2  # values of a signal that else stands still, or of one with a single coarse step
_BEYOND: Final = 2.0  # times its usual value: more than any coarse step


class NoReading(NamedTuple):
    """A number of a signal that stands for no reading, and how many samples hold it."""

    signal: str
    number: float
    samples: int


def no_readings(values: Mapping[str, Floats]) -> list[NoReading]:
    """Return the numbers that stand for no reading, by signal.

    >>> t = np.arange(2_000) / 50
    >>> p1, Q = 150 + np.sin(t), 40 + np.cos(t)
    >>> p1[50::90] = -999.0
    >>> no_readings({"p1": p1, "Q": Q})
    [NoReading(signal='p1', number=-999.0, samples=22)]
    """
    found = []
    jumps = {name: _jumps(x) for name, x in values.items()}
    noticed = {name: _noticed(x, jumps[name]) for name, x in values.items()}
    for name, x in values.items():
        others = [noticed[other] for other in values if other != name]
        alone = jumps[name] & ~np.logical_or.reduce(others) if others else jumps[name]
        numbers, counts = np.unique(x[alone], return_counts=True)
        for number in numbers[counts >= _OFTEN].tolist():
            samples = int((x == number).sum())
            if samples <= _RARE * len(x):
                found.append(NoReading(name, float(number), samples))
    return found


def _span(x: Floats) -> float:
    good = x[np.isfinite(x)]
    low, high = np.percentile(good, _USUAL) if len(good) else (0.0, 0.0)
    return float(high - low)


def _least_jump(good: Floats) -> float:
    readings = np.unique(good)
    if len(readings) > _TWO:
        return max(_FAR * _span(good), _STEPS * float(np.diff(readings).min()))
    usual = float(np.median(np.abs(good))) if len(readings) == _TWO else 0.0
    return _BEYOND * usual or np.inf


def _jumps(x: Floats) -> NDArray[np.bool_]:
    """Whether each sample is one of a short jump from the curve and back."""
    found = np.zeros(len(x), np.bool_)
    least = _least_jump(x[np.isfinite(x)])
    for length in range(1, _LONGEST + 1):
        if len(x) <= length + 1:
            break
        before, first, after = x[: -length - 1], x[1:-length], x[length + 1 :]
        jump = np.minimum(np.abs(first - before), np.abs(first - after))
        is_jump = (jump > least) & (np.abs(after - before) < _BACK * jump)
        for k in range(1, length + 1):
            is_jump &= x[k : len(x) - length - 1 + k] == first
        for k in range(1, length + 1):
            found[k : len(x) - length - 1 + k] |= is_jump
    return found


def _noticed(x: Floats, jumps: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether a signal moves at each sample against those around it, by more than usual."""
    found = np.zeros(len(x), np.bool_)
    usual = _GOES_ON * _span(x)
    found[1:-1] = np.abs(x[1:-1] - 0.5 * (x[:-2] + x[2:])) > usual
    return found & ~jumps & np.isfinite(x)
