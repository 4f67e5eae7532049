"""What flows through the core: samples in, traces out, both as structures of arrays."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Times = NDArray[np.int64]
Codes = NDArray[np.uint8]
Flags = NDArray[np.bool_]


class Quality(IntEnum):
    """How far one sample can be trusted; the quality gate decides."""

    GOOD = 0
    UNCERTAIN = 1
    BAD = 2


class Status(IntEnum):
    """What an estimator did with one sample: numerical trouble is a value, not an exception."""

    OK = 0
    WARMING_UP = 1
    UNEXCITED = 2
    REJECTED = 3
    FROZEN = 4
    HELD = 5
    EXTRAPOLATING = 6
    FAILED = 7

    @property
    def sentence(self) -> str:
        """A sentence for the operator."""
        return _STATUS_SENTENCES[self]


_STATUS_SENTENCES = {
    Status.OK: "The sample was used and the parameters are determined.",
    Status.WARMING_UP: "The samples so far do not determine all parameters.",
    Status.UNEXCITED: "The inputs do not vary in some direction; the parameters there are held.",
    Status.REJECTED: "The sample is not finite or of bad quality; the state was not touched.",
    Status.FROZEN: "Adaptation is switched off; the sample was predicted only.",
    Status.HELD: "The update would have left the range of numbers; the state was not touched.",
    Status.EXTRAPOLATING: "Nothing was measured near this point, or it lies beyond what the "
    "estimator can describe; nothing was learnt from it.",
    Status.FAILED: "The estimator stopped at an unexpected error; its last state is kept. Reset "
    "starts it again; the alarm LaneFailed names the reason.",
}


@dataclass(frozen=True)
class Samples:
    """N samples of one valve, all arrays of shape (N,).

    Attributes
    ----------
    t : int64
        Source time, UTC ns.
    U : float64
        Control voltage, % of its range.
    p1, p2 : float64
        Pressures before and behind the valve, bar.
    Q : float64
        Flow through the valve, l/min.
    T : float64
        Oil temperature, °C; NaN where there is no sensor.
    quality : uint8
        :class:`Quality`.

    Examples
    --------
    >>> samples = Samples.of(t=[0, 1], U=[10, 20], p1=[200, 200], p2=[100, 0], Q=[9, 30])
    >>> samples.dp
    array([100., 200.])
    >>> len(samples[1:])
    1
    """

    t: Times
    U: Floats
    p1: Floats
    p2: Floats
    Q: Floats
    T: Floats
    quality: Codes

    @classmethod
    def of(
        cls,
        t: ArrayLike,
        U: ArrayLike,
        p1: ArrayLike,
        p2: ArrayLike,
        Q: ArrayLike,
        T: ArrayLike | None = None,
        quality: ArrayLike | None = None,
    ) -> Self:
        """Take anything array-like; T defaults to NaN, quality to GOOD."""
        time = np.ascontiguousarray(t, dtype=np.int64)
        return cls(
            t=time,
            U=np.ascontiguousarray(U, dtype=np.float64),
            p1=np.ascontiguousarray(p1, dtype=np.float64),
            p2=np.ascontiguousarray(p2, dtype=np.float64),
            Q=np.ascontiguousarray(Q, dtype=np.float64),
            T=np.full(time.shape, np.nan) if T is None else np.ascontiguousarray(T, np.float64),
            quality=(
                np.full(time.shape, Quality.GOOD, np.uint8)
                if quality is None
                else np.ascontiguousarray(quality, np.uint8)
            ),
        )

    @classmethod
    def empty(cls) -> Self:
        """No samples."""
        return cls.of(t=[], U=[], p1=[], p2=[], Q=[])

    @classmethod
    def concatenate(cls, parts: Sequence[Self]) -> Self:
        """One batch from several, in their order."""
        if not parts:
            return cls.empty()
        columns = {f.name: [getattr(part, f.name) for part in parts] for f in fields(cls)}
        return cls(**{name: np.concatenate(column) for name, column in columns.items()})

    @property
    def dp(self) -> Floats:
        """Pressure drop p1 - p2, bar."""
        return self.p1 - self.p2

    def __len__(self) -> int:
        return len(self.t)

    def __getitem__(self, rows: slice | NDArray[np.bool_] | NDArray[np.int64]) -> Self:
        return type(self)(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


class Segments(NamedTuple):
    """Whose samples are whose: model ``members[s]`` of many takes rows starts[s] … stops[s] - 1.

    All arrays (S,) of int64; a model appears once at most.
    """

    members: Times
    starts: Times
    stops: Times

    @classmethod
    def one(cls, rows: int) -> "Segments":
        """All rows to model 0."""
        return cls(np.zeros(1, np.int64), np.zeros(1, np.int64), np.full(1, rows, np.int64))

    def of(self, chosen: NDArray[np.bool_]) -> "Segments":
        """Some of the segments; ``chosen`` (S,)."""
        return Segments(*(array[chosen] for array in self))

    def among(self, rows: NDArray[np.bool_]) -> "Segments":
        """Where the segments lie once only ``rows`` (N,) are kept."""
        before = np.concatenate([np.zeros(1, np.int64), np.cumsum(rows)])
        return Segments(self.members, before[self.starts], before[self.stops])


@dataclass(frozen=True)
class Trace:
    """What an estimator says of each of N samples, all arrays of shape (N,).

    Attributes
    ----------
    predicted : float64
        Q̂ from the parameters *before* the sample, l/min; NaN where nothing can be said.
    residual : float64
        Q - Q̂ before the update (the innovation), l/min; NaN where nothing can be said.
    early : float64
        Q - Q̂ of the map as it was up to 31 samples before, l/min: the error of what was published
        ahead. NaN where it was not looked at; the residual, if the map stands still.
    status : uint8
        :class:`Status`.
    """

    predicted: Floats
    residual: Floats
    early: Floats
    status: Codes

    def __len__(self) -> int:
        return len(self.status)
