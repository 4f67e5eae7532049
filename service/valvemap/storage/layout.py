"""Which columns of a recording hold the signals of which valve, as configured and as found."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from valvemap.errors import RecordingError
from valvemap.model.samples import Codes, Floats, Samples, Times
from valvemap.pipeline.units import (
    Measure,
    Scaling,
)
from valvemap.plant.evidence import Rating
from valvemap.vocabulary import signals

if TYPE_CHECKING:  # a saved map needs none of it
    from valvemap.plant.reading import Given

REQUIRED: Final = ("t", *signals.REQUIRED)
DEFAULT_VALVE: Final = "Valvistor"
COLUMNS: Final = (*REQUIRED, *signals.OPTIONAL, "valve", "quality")
"""Headings of the files that `valvemap record` writes: its numbers are in internal units."""


@dataclass(frozen=True)
class ValveLayout:
    """The columns of one valve's signals; others are found by the signals' names.

    If ``drop``, the column of p1 holds p1 - p2, where one is configured, and p2 is 0. ``recorded``:
    a file with a column of valves, and without these, is one of `valvemap record`; so is any with
    the headings `COLUMNS`, unless other columns are configured.
    """

    valve: str
    signals: Mapping[str, Measure] = field(default_factory=dict)
    drop: bool = False
    recorded: bool = False

    @property
    def has_columns(self) -> bool:
        """Whether columns are configured."""
        return any(signal.column is not None for signal in self.signals.values())


@dataclass(frozen=True)
class Layout:
    """The layout of recordings; without ``valves`` all valves of a file are read.

    ``time``, ``valve`` and ``quality`` are column names; None: the default names. ``signals`` are
    those of all valves without ``valves``. ``header`` are the headings of a file that has none;
    ``given`` answers questions about columns and their units, by valve; ``seconds`` is the unit of
    the times, if it is stated (None: as the heading says). ``rating`` is of the name plate.
    """

    valves: tuple[ValveLayout, ...] = ()
    time: str | None = None
    valve: str | None = None
    quality: str | None = None
    signals: Mapping[str, Measure] = field(default_factory=dict)
    header: tuple[str, ...] | None = None
    given: Mapping[str, "Given"] = field(default_factory=dict)
    seconds: float | None = None
    rating: Rating = field(default_factory=Rating)

    @property
    def recognises(self) -> bool:
        """Whether foreign headings may be recognised: no column is configured."""
        every = (*self.valves, ValveLayout("", self.signals))
        return self.valve is None and not any(valve.has_columns for valve in every)


class MissingColumnError(RecordingError):
    """The headings are not those of a recording of ours."""


@dataclass(frozen=True)
class Part:
    """The column numbers of one valve's samples.

    ``valve`` is None if the valve column names the valve of each row; with ``selects``, only the
    rows that name this valve are used. ``seconds`` is the unit of the times. Without a column of
    p2, p1 is the pressure drop, and p2 is 0. ``in_heading`` are the signals whose unit the heading
    states, ``stated`` those whose unit is stated anywhere; ``recognised``: by foreign headings, and
    so judged already.
    """

    valve: str | None
    t: int
    numbers: Mapping[str, tuple[int, Scaling]]
    selects: bool = False
    seconds: float = 1.0
    in_heading: frozenset[str] = frozenset()
    stated: frozenset[str] = frozenset()
    recognised: bool = False


@dataclass(frozen=True)
class Columns:
    """The columns of one file; ``ignored`` are unknown headings."""

    parts: tuple[Part, ...]
    valve: int | None
    quality: int | None
    ignored: tuple[str, ...]


def with_p2(t: Times, quality: Codes | None, numbers: Mapping[str, Floats]) -> Samples:
    """Return samples; without p2, p1 is the pressure drop, and p2 is 0."""
    whole = numbers if "p2" in numbers else {**numbers, "p2": np.zeros(len(t))}
    return Samples.of(t=t, quality=quality, **whole)
