"""Data types of the core: samples as input, traces as output, both as structures of arrays."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cache
from operator import attrgetter
from typing import Any, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from valvemap.vocabulary.signals import MEASURED
from valvemap.vocabulary.statuses import Quality

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Times = NDArray[np.int64]
Codes = NDArray[np.uint8]
Flags = NDArray[np.bool_]

D = TypeVar("D", bound=np.generic)


def field_names(kind: type[Any]) -> tuple[str, ...]:
    """Names of the fields of a dataclass, in their order."""
    return _field_names(kind)  # type: ignore[arg-type] # a class is hashable


@cache
def _field_names(kind: type[Any]) -> tuple[str, ...]:
    return tuple(field.name for field in fields(kind))


def columns_of(one: Any) -> tuple[Any, ...]:  # noqa: ANN401 - any dataclass
    """Return the values of all fields of a dataclass, in their order."""
    return _getter(type(one))(one)  # type: ignore[arg-type] # a class is hashable


@cache
def _getter(kind: Any) -> Callable[[Any], tuple[Any, ...]]:  # noqa: ANN401 - a class
    names = field_names(kind)
    if len(names) == 1:  # `attrgetter` then returns the value alone
        return lambda one: (getattr(one, names[0]),)
    return attrgetter(*names)


def column(values: ArrayLike, kind: type[D]) -> NDArray[D]:
    """Return values as a contiguous array that may be written, a copy only where needed.

    A kernel would be compiled again for a read-only array.
    """
    found = np.ascontiguousarray(values, dtype=kind)
    return found if found.flags.writeable else found.copy()


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
        Pressures upstream and downstream of the valve, bar.
    Q : float64
        Flow through the valve, l/min.
    T : float64
        Oil temperature, °C.

    The signals are those of :mod:`~valvemap.vocabulary.signals`, in its order; optional ones are
    NaN where there is no sensor.

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
        **optional: ArrayLike | None,
    ) -> Self:
        """Convert anything array-like; optional signals default to NaN, quality to GOOD."""
        time = column(t, np.int64)
        given = {"U": U, "p1": p1, "p2": p2, "Q": Q, "T": T, **optional}
        signals = {
            name: np.full(time.shape, np.nan)
            if (values := given.pop(name, None)) is None
            else column(values, np.float64)
            for name in MEASURED
        }
        assert not given, f"no such signals: {list(given)}"  # noqa: S101 - a programmer's mistake
        return cls(
            t=time,
            **signals,
            quality=(
                np.full(time.shape, Quality.GOOD, np.uint8)
                if quality is None
                else column(quality, np.uint8)
            ),
        )

    @classmethod
    def empty(cls) -> Self:
        """Return no samples."""
        return cls.of(t=[], U=[], p1=[], p2=[], Q=[])

    @classmethod
    def concatenate(cls, parts: Sequence[Self]) -> Self:
        """Concatenate batches in order."""
        if not parts:
            return cls.empty()
        columns = {name: [getattr(part, name) for part in parts] for name in field_names(cls)}
        return cls(**{name: np.concatenate(column) for name, column in columns.items()})

    @classmethod
    def from_values(cls, t: Times, values: Floats, quality: NDArray[np.uint8]) -> Self:
        """Restore samples from `values`, in the order of the table, (N, COUNT)."""
        columns = dict(zip(MEASURED, np.ascontiguousarray(values.T), strict=True))
        return cls(t=t, quality=quality, **columns)

    @property
    def values(self) -> Floats:
        """Return all signals in the order of the table, (N, COUNT)."""
        found = np.empty((len(self.t), len(MEASURED)))
        for k, name in enumerate(MEASURED):
            found[:, k] = getattr(self, name)
        return found

    @property
    def dp(self) -> Floats:
        """Pressure drop p1 - p2, bar."""
        return self.p1 - self.p2

    def __len__(self) -> int:
        return len(self.t)

    def __getitem__(self, rows: slice | NDArray[np.bool_] | NDArray[np.int64]) -> Self:
        return type(self)(*[column[rows] for column in columns_of(self)])


class Segments(NamedTuple):
    """Assignment of samples to models: model ``members[s]`` owns rows starts[s] … stops[s] - 1.

    All arrays (S,) of int64; a model appears at most once.
    """

    members: Times
    starts: Times
    stops: Times

    @classmethod
    def one(cls, rows: int) -> "Segments":
        """Assign all rows to model 0."""
        return cls(np.zeros(1, np.int64), np.zeros(1, np.int64), np.full(1, rows, np.int64))

    def of(self, chosen: NDArray[np.bool_]) -> "Segments":
        """Return the chosen segments; ``chosen`` is a mask (S,)."""
        return Segments(self.members[chosen], self.starts[chosen], self.stops[chosen])

    def among(self, rows: NDArray[np.bool_]) -> "Segments":
        """Return the segments after a selection of rows by a mask (N,)."""
        before = np.concatenate([np.zeros(1, np.int64), np.cumsum(rows)])
        return Segments(self.members, before[self.starts], before[self.stops])


@dataclass(frozen=True)
class Trace:
    """Results of an estimator for N samples, all arrays of shape (N,).

    Attributes
    ----------
    predicted : float64
        Q̂ from the parameters *before* the sample, l/min; NaN where unknown.
    residual : float64
        Q - Q̂ before the update (the innovation), l/min; NaN where unknown.
    early : float64
        Q - Q̂ of the map as it was up to 31 samples before, l/min: the error of published
        predictions. NaN where it was not evaluated; equal to the residual if the map is frozen.
    status : uint8
        :class:`Status`.
    """

    predicted: Floats
    residual: Floats
    early: Floats
    status: Codes

    def put(self, rows: slice | Flags, part: "Trace") -> None:
        """Write the results of the given samples; ``rows`` is a slice or a mask (N,)."""
        for name in field_names(Trace):
            getattr(self, name)[rows] = getattr(part, name)

    def __len__(self) -> int:
        return len(self.status)
