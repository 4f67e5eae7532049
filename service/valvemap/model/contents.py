"""Valid values of a state's arrays, by index: checkpoints are validated before the restoration."""

from types import EllipsisType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

MOST_COUNTED: Final = 10**15  # largest count: 30,000 years at 1 kHz
_INTEGERS: Final = "iu"

Places = int | slice | list[int] | NDArray[Any]
Where = EllipsisType | Places | tuple[Places, ...]


class Contents:
    """Valid values of an array with the shape and type of a template.

    By default, floats are finite, and integers are counts from 0 to 10¹⁵.

    Examples
    --------
    >>> share = Contents(np.zeros(3)).within(0.0, 1.0).or_nan(2)
    >>> share.wrong_in(np.array([0.0, 1.0, np.nan]))
    >>> share.wrong_in(np.array([0.0, 1.5, 0.0]))
    'holds 1.5 at place 1'
    >>> share.wrong_in(np.zeros(4))
    'is of shape (4,) and float64, not of (3,) and float64'
    """

    def __init__(self, like: NDArray[Any]) -> None:
        self._like = like
        counts = like.dtype.kind in _INTEGERS
        low, high = (0, MOST_COUNTED) if counts else (-np.inf, np.inf)
        bounds = np.int64 if counts else np.float64
        self._low, self._high = np.full(like.shape, low, bounds), np.full(like.shape, high, bounds)
        self._nan = np.zeros(like.shape, np.bool_)
        self._inf = np.zeros(like.shape, np.bool_)

    def within(self, low: float, high: float = np.inf, where: Where = ...) -> "Contents":
        """Restrict values to this range; without ``high``, counts keep their limit."""
        self._low[where] = low
        self._high[where] = MOST_COUNTED if self._counts and high == np.inf else high
        return self

    def any_time(self, where: Where = ...) -> "Contents":
        """Allow any integer: a time, UTC ns."""
        limits = np.iinfo(np.int64)
        self._low[where], self._high[where] = limits.min, limits.max
        return self

    def or_nan(self, where: Where = ..., *, allowed: bool = True) -> "Contents":
        """Allow NaN, for unknown values."""
        self._nan[where] = allowed
        return self

    def or_infinite(self, where: Where = ...) -> "Contents":
        """Allow infinity."""
        self._inf[where] = True
        return self

    def wrong_in(self, array: NDArray[Any]) -> str | None:
        """Return a description of the first invalid value, None if all are valid."""
        like = self._like
        if array.shape != like.shape or array.dtype != like.dtype:
            ours, other = (f"{a.shape} and {a.dtype}" for a in (like, array))
            return f"is of shape {other}, not of {ours}"
        if array.dtype.kind not in f"{_INTEGERS}f" or not array.size:
            return None
        with np.errstate(invalid="ignore"):
            right = (array >= self._low) & (array <= self._high)
        if not self._counts and not (right.all() and np.isfinite(array).all()):
            right &= np.isfinite(array) | self._inf
            right |= self._nan & np.isnan(array)
        if right.all():
            return None
        place = int(np.argmin(right))
        return f"holds {array.reshape(-1)[place]:g} at place {place}"

    @property
    def _counts(self) -> bool:
        return self._like.dtype.kind in _INTEGERS
