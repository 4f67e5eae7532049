"""What is kept of an axis beside what it has learnt, as bytes: its place in the streams. Pure.

A sample is the more recent of its two lines': the arrivals of both lines, the samples of one that
wait for the other's, and the filters of rest and travel belong to the position of the source with
which they are stored.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np

from valvemap.model.axis_rest import Rest
from valvemap.model.axis_travel import Travel
from valvemap.model.contents import Contents
from valvemap.model.estimator import State, StateMismatchError, key_of
from valvemap.model.samples import Floats, Times
from valvemap.pipeline.alignment import Alignment, AlignmentSettings, optional_in_keys
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.axis_arrivals import LINES
from valvemap.pipeline.edges import MOST_WAITING, NEVER_MET
from valvemap.pipeline.kept_arrivals import KeptArrivals, arrays_of_arrivals, length_of
from valvemap.pipeline.timing import TimingSettings, TimingState

MEMORY: Final = "AxisMemory"
OF_LINES: Final = ("AxisLineA", "AxisLineB")  # names of the stored parts, by line
TIMINGS: Final = ("AxisTimingA", "AxisTimingB")
MEMORIES: Final = frozenset({MEMORY, *OF_LINES, *TIMINGS})
COLUMNS: Final = 5  # U, p1, p2, position or speed, T or set position
NEWEST: Final = 6  # x, T, pA, pB, pS, pT


@dataclass(frozen=True)
class Unmet:
    """Samples of one line that wait for the other's: times (N,) and columns (COLUMNS, N)."""

    t: Times
    values: Floats

    @classmethod
    def nothing(cls, count: int = 0) -> Self:
        """Return ``count`` samples without content."""
        return cls(np.zeros(count, np.int64), np.zeros((COLUMNS, count)))

    def and_then(self, t: Times, values: Floats) -> "Unmet":
        """Return these samples, and others behind them."""
        return Unmet(np.concatenate([self.t, t]), np.concatenate([self.values, values], axis=1))

    def without(self, past: int) -> "Unmet":
        """Return the samples from ``past`` on."""
        return Unmet(self.t[past:], self.values[:, past:])


@dataclass(frozen=True)
class AxisMemory:
    """``t`` is the time of the newest sample, UTC ns; ``newest`` are its U and `NEWEST` others.

    ``met`` (1,) is the time of the last match of both lines, ``unpaired`` the number of samples of
    line A that never met one of line B.
    """

    unmet: tuple[Unmet, Unmet]
    met: Times
    rest: Rest
    travel: Travel
    t: int
    newest: Floats
    unpaired: int


@dataclass(frozen=True)
class _Kept(State):
    """An axis beside its lines."""

    met: Any
    rest_last: Any
    rest_memory: Any
    travel_last: Any
    travel_memory: Any
    moment: Any
    newest: Any
    unpaired: Any

    @classmethod
    def of(cls, one: AxisMemory) -> Self:
        """Return the arrays of a memory."""
        return cls(
            one.met,
            one.rest.last,
            one.rest.memory,
            one.travel.last,
            one.travel.memory,
            moment=np.array(one.t),
            newest=one.newest,
            unpaired=np.array(one.unpaired),
        )

    def contents(self) -> Mapping[str, Contents]:
        """Return the permitted content."""
        times = ("met", "rest_last", "travel_last", "moment")
        found = {name: Contents(np.asarray(getattr(self, name))).any_time() for name in times}
        return {**found, "newest": Contents(self.newest).or_nan()}


@dataclass(frozen=True)
class _KeptLine(KeptArrivals):
    """The arrivals of one line, and its samples that wait for the other line's."""

    unmet_t: Any
    unmet_values: Any

    @classmethod
    def like(cls, other: Self, alignment: Alignment) -> Self:
        """Return an initial state with as many samples as ``other``."""
        unmet = Unmet.nothing(length_of(other.unmet_t, 0))
        return cls(**other.arrivals_like(alignment), unmet_t=unmet.t, unmet_values=unmet.values)

    def contents(self) -> Mapping[str, Contents]:
        """Return the permitted content."""
        return {
            **super().contents(),
            "unmet_t": Contents(self.unmet_t).any_time(),
            "unmet_values": Contents(self.unmet_values).or_nan(),
        }


@dataclass(frozen=True)
class _Comes:
    """The configuration that the arrivals of an axis depend on; ``axis`` is the key of its map."""

    axis: str
    alignment: AlignmentSettings
    timing: TimingSettings | None
    optional: tuple[bool | tuple[str, ...], ...]
    numbered: bool


class AxisMemories:
    """Packs and restores the memories of axes; rows 2k and 2k + 1 of ``arrivals`` are axis k's."""

    def __init__(self, arrivals: Arrivals, keys: Mapping[int, str]) -> None:
        self._arrivals = arrivals
        self._keys = {number: self._key(number, key) for number, key in keys.items()}

    def packed(self, number: int, memory: AxisMemory) -> Iterator[tuple[str, bytes]]:
        """Yield name and bytes of each part of an axis' memory."""
        key = self._keys[number]
        yield MEMORY, _Kept.of(memory).to_bytes(key)
        for line, unmet in enumerate(memory.unmet):
            row = LINES * number + line
            own = arrays_of_arrivals(self._arrivals.view(row))
            yield (
                OF_LINES[line],
                _KeptLine(**own, unmet_t=unmet.t, unmet_values=unmet.values).to_bytes(key),
            )
            if self._arrivals.finds_timing:
                state = self._arrivals.timing.valves[row].state
                yield TIMINGS[line], state.to_bytes(key)

    def restored(self, number: int, stored: Mapping[str, bytes]) -> AxisMemory:
        """Restore the arrivals of both lines; return the rest of the memory.

        Raises
        ------
        StateMismatchError
            if a part is missing, damaged, or belongs to another configuration; nothing is restored
            then.
        """
        if not {MEMORY, *OF_LINES} <= stored.keys():
            raise StateMismatchError("a part of it is missing")
        key, alignment = self._keys[number], self._arrivals.alignment
        kept = _Kept.from_bytes(stored[MEMORY], key)
        kept.check(_Kept.of(_nothing()))
        lines = [_KeptLine.from_bytes(stored[name], key) for name in OF_LINES]
        for one in lines:
            one.check(_KeptLine.like(one, alignment))
            if len(one.unmet_t) > MOST_WAITING:
                raise StateMismatchError(f"{len(one.unmet_t)} samples wait, {MOST_WAITING} may")
        timings = [
            TimingState.from_bytes(stored[name], key)
            for name in TIMINGS
            if self._arrivals.finds_timing and name in stored
        ]
        first = LINES * number
        for row, timing in enumerate(timings, first):
            self._arrivals.timing.put(row, timing)
        for row, one in enumerate(lines, first):
            self._arrivals.put(row, one.arrivals())
        unmet_A, unmet_B = (Unmet(one.unmet_t, one.unmet_values) for one in lines)
        return AxisMemory(
            (unmet_A, unmet_B),
            kept.met,
            Rest(kept.rest_last, kept.rest_memory),
            Travel(kept.travel_last, kept.travel_memory),
            int(kept.moment),
            kept.newest,
            int(kept.unpaired),
        )

    def _key(self, number: int, key: str) -> str:
        first, alignment = LINES * number, self._arrivals.alignment
        rows = slice(first, first + LINES)
        return key_of(
            _Comes(
                key,
                alignment.settings,
                self._arrivals.timing.settings if self._arrivals.finds_timing else None,
                tuple(map(optional_in_keys, alignment.optional[rows])),
                bool(alignment.has_sequence) and alignment.has_sequence[first],
            )
        )


def _nothing() -> AxisMemory:
    unmet = Unmet.nothing(), Unmet.nothing()
    newest = np.full(1 + NEWEST, np.nan)
    met = np.array([NEVER_MET])
    return AxisMemory(unmet, met, Rest.initial(), Travel.initial(), 0, newest, 0)
