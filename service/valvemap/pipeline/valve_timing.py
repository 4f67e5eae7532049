"""Timing of one valve's signals: detected from the first changes, then fixed.

Signals with the same timestamp pass unchanged. Others are held back until their timing is detected
(:mod:`valvemap.pipeline.scan_search`), then converted into scans of one time each
(:mod:`valvemap.pipeline.kernels.scans`), the held-back changes first. The result does not depend on
how the changes are cut into batches.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from valvemap.model.contents import Contents
from valvemap.model.estimator import State, StateMismatchError
from valvemap.model.samples import Times
from valvemap.pipeline.alignment import presence
from valvemap.pipeline.kernels import scans as kernel
from valvemap.pipeline.kernels.scans import NEVER, Changed, ScanRules, Scans
from valvemap.pipeline.scan_search import Comes, Found, find_scans, is_stamped_alike, only_changes
from valvemap.pipeline.timing_words import Words
from valvemap.vocabulary.signals import PER_VALVE, Signal

LISTEN_NS: Final = 5_000_000_000  # detection of the timing needs this long …
LISTEN_VALUES: Final = 25  # … and this many values of the fastest signal, …
LISTEN_LONGEST_NS: Final = 60_000_000_000  # … or this time …
LISTEN_FEWEST: Final = 8  # … and this many values
ENOUGH_PER_SIGNAL: Final = 20  # values until a source is accepted as using one timestamp
MOST_HELD_BACK: Final = 8192  # changes held back per valve
_PENDING: Final = 1024  # changes of a valve buffered for scans
_AGAIN: Final = 1.25  # growth of the held-back changes between two attempts at detection
_BACK: Final = ("back_signal", "back_value", "back_status", "back_time")
_OF_SIGNALS: Final = ("comes", "offset", "limit", "jitter", "deadband")

LISTENING, DOUBTFUL, ALIKE, IN_SCANS = range(4)  # state of the detection


@dataclass(frozen=True)
class TimingSettings:
    """When a scan is complete; ns.

    ``horizon_ns``: a value is missing once other signals are newer by this much.
    ``max_wait_ns``: a source time that steps back by more is a step of the source's clock.
    """

    horizon_ns: int = 1_000_000_000
    max_wait_ns: int = 2_000_000_000


@dataclass(frozen=True)
class TimingState(State):
    """State of the detection of one valve's timing, and the changes buffered for scans.

    ``stands`` () is LISTENING, DOUBTFUL, ALIKE or IN_SCANS; ``comes``, ``offset``, ``limit``,
    ``jitter``, ``deadband`` (6,), ``period`` and ``window`` () are those of `Found`; arrays named
    ``back_…`` (N,) hold the held-back changes; the rest are the arrays of `Scans`.
    """

    stands: Any
    comes: Any
    offset: Any
    limit: Any
    jitter: Any
    deadband: Any
    period: Any
    window: Any
    back_signal: Any
    back_value: Any
    back_status: Any
    back_time: Any
    time: Any
    signal: Any
    value: Any
    status: Any
    now_value: Any
    now_status: Any
    now_time: Any
    now_rate: Any
    seen: Any
    lacking: Any
    moved: Any
    course: Any

    def contents(self) -> Mapping[str, Contents]:
        """Return the permitted content; ``course`` must count all buffered changes."""
        times = ("offset", "back_time", "time", "now_time", "seen", "course")
        found = {name: Contents(getattr(self, name)).any_time() for name in times}
        raw = ("limit", "jitter", "back_value", "value", "now_value", "now_rate")
        for name in raw:
            found[name] = Contents(getattr(self, name)).or_nan().or_infinite()
        for name in ("back_signal", "signal"):
            found[name] = Contents(getattr(self, name)).within(0, PER_VALVE - 1)
        for name in ("limit", "jitter"):
            found[name].within(0.0)
        found["deadband"] = Contents(self.deadband).within(0.0)
        size = int(self.course[kernel.SIZE])
        found["course"].within(size, size, kernel.SIZE)
        found["stands"] = Contents(self.stands).within(LISTENING, IN_SCANS)
        found["comes"] = Contents(self.comes).within(min(Comes), max(Comes))
        return found


class ValveTiming:
    """Timing of one valve's signals."""

    def __init__(
        self,
        settings: TimingSettings,
        *,
        optional: tuple[str, ...],
        has_sequence: bool,
        rests: bool = False,
    ) -> None:
        self._settings, self._rests = settings, rests
        self._there = np.append(presence([optional])[0], has_sequence)
        self.stands = LISTENING
        self.found: Found | None = None
        self._back = NOTHING
        self._looked_at = 0
        self._scans = _no_scans(0)  # most valves need no scans

    def take(self, changes: Changed, *, flush: bool = False) -> Changed:
        """Process changes; return those that are due, in the order of scans if there are any."""
        if self.stands == ALIKE:
            return changes
        if self.stands == IN_SCANS:
            return self._into_scans(changes, flush=flush)
        self._back = _joined(self._back, changes)
        return self._listen(changes)

    def _listen(self, newest: Changed) -> Changed:
        if self.stands == DOUBTFUL:
            return self._doubt(newest)
        while len(self._back.time) >= _AGAIN * self._looked_at:
            self._looked_at = len(self._back.time)
            end = self._end()
            first = self._back if end < 0 else _part(self._back, 0, end)
            if self._has_one_instant(first):
                self.stands = DOUBTFUL
                return self._doubt(self._back)
            if end < 0:
                break
            found = find_scans(first, self._there)
            if found is not None:
                self._settle(found, first)
                back, self._back = self._back, NOTHING
                return self._into_scans(back)
            self._back, self._looked_at = _without_first(self._back, (end + 1) // 2), 0
        return NOTHING

    def _doubt(self, passed: Changed) -> Changed:
        """Decide whether most samples have one timestamp; until then changes pass unchanged."""
        back = self._back
        enough = ENOUGH_PER_SIGNAL * int(self._there.sum())
        if len(back.time) < enough:
            return passed
        alike = is_stamped_alike(_part(back, 0, enough), self._there)
        if alike and not (self._rests and only_changes(_part(back, 0, enough), Signal.U)):
            self.stands, self._back = ALIKE, NOTHING
            return passed
        end = self._end()
        if end < 0:
            if len(back.time) >= MOST_HELD_BACK:
                self.stands, self._back = ALIKE, NOTHING
            return passed
        found = find_scans(_part(back, 0, end), self._there)
        if found is None:
            self.stands, self._back = ALIKE, NOTHING
            return passed
        self._settle(found, _part(back, 0, end))
        rest = len(back.time) - end
        cut = max(len(passed.time) - rest, 0)
        self._into_scans(_part(back, 0, end))
        self._scans.lacking[:] = self._scans.moved[:] = 0
        on = self._into_scans(_part(back, end, len(back.time)))
        self._back = NOTHING
        return _joined(_part(passed, 0, cut), on)

    def _has_one_instant(self, back: Changed) -> bool:
        common: Times | None = None
        for j in np.flatnonzero(self._there):
            own = np.unique(back.time[back.signal == j])
            common = own if common is None else np.intersect1d(common, own, assume_unique=True)
            if not len(common):
                return False
        return True

    def _end(self) -> int:
        """Number of changes needed to detect the timing; -1: not yet reached."""
        newest = np.maximum.accumulate(self._back.time)
        second, counted, few = (
            self._first_with(number) for number in (2, LISTEN_VALUES, LISTEN_FEWEST)
        )
        if second == len(newest):
            return -1
        since = newest[second:] - newest[second]
        soon = max(second + int(np.searchsorted(since, LISTEN_NS)), counted)
        late = max(second + int(np.searchsorted(since, LISTEN_LONGEST_NS)), few)
        end = min(soon, late, MOST_HELD_BACK - 1)
        return end + 1 if end < len(newest) else -1

    def _first_with(self, number: int) -> int:
        """Index of the change at which a signal first has ``number`` values."""
        signal = self._back.signal
        places = (np.flatnonzero(signal == j) for j in np.flatnonzero(self._there))
        return min(
            (int(own[number - 1]) for own in places if len(own) >= number), default=len(signal)
        )

    def _settle(self, found: Found, heard: Changed) -> None:
        if self._rests and only_changes(heard, Signal.U):
            found.comes[Signal.U] = Comes.HELD
        self.found, self.stands, self._scans = found, IN_SCANS, _no_scans(_PENDING)

    def _into_scans(self, changes: Changed, *, flush: bool = False) -> Changed:
        found = self.found
        assert found is not None  # noqa: S101 - it stands in scans
        rules = ScanRules(
            there=self._there,
            held=found.comes == Comes.HELD,
            limit=found.limit,
            jitter=found.jitter,
            window=found.window,
            period=found.period,
            horizon=self._settings.horizon_ns,
            max_wait=self._settings.max_wait_ns,
        )
        waiting = int(self._scans.course[kernel.SIZE])
        out = _room(PER_VALVE * (len(changes.time) + waiting))
        n = kernel.make_scans(changes, flush, rules, self._scans, out)
        return _part(out, 0, n)

    @property
    def pending(self) -> int:
        """Number of changes buffered for scans."""
        return int(self._scans.course[kernel.SIZE])

    @property
    def not_made(self) -> int:
        """Number of scans that gave no sample."""
        return int(self._scans.lacking.sum() + self._scans.moved.sum())

    @property
    def may_rest(self) -> bool:
        """Whether silence is no loss: signals come on change, or it is not known yet how.

        Each has sent a value: else one is missing.
        """
        if self.stands == ALIKE or (self.newest[self._there] == NEVER).any():
            return False
        return self.found is None or bool((self.found.comes == Comes.HELD).any())

    @property
    def newest(self) -> Times:
        """Source time of each signal's newest value, (6,), UTC ns; NEVER before the first."""
        newest = self._scans.seen.copy()
        for j in range(PER_VALVE):
            own = self._back.time[self._back.signal == j]
            if len(own):
                newest[j] = max(int(newest[j]), int(own.max()))
        return newest

    @property
    def words(self) -> Words:
        """Data for the description of the timing."""
        if self.stands == LISTENING:
            return Words(None, self._there, self._scans, is_found=False)
        return Words(self.found, self._there, self._scans)

    @property
    def state(self) -> TimingState:
        """The whole state; buffers are trimmed to the part in use."""
        found = self.found or _NOT_FOUND
        size = self.pending
        arrays = self._scans._asdict()
        for name in ("time", "signal", "value", "status"):
            arrays[name] = arrays[name][:size]
        return TimingState(
            stands=np.array(self.stands),
            comes=found.comes,
            offset=found.offset,
            limit=found.limit,
            jitter=found.jitter,
            deadband=found.deadband,
            period=np.array(found.period),
            window=np.array(found.window),
            back_signal=self._back.signal,
            back_value=self._back.value,
            back_status=self._back.status,
            back_time=self._back.time,
            **{name: array.copy() for name, array in arrays.items()},
        )

    def put(self, state: TimingState) -> None:
        """Restore a stored state.

        Raises
        ------
        StateMismatchError
            if its shapes or contents are invalid.
        """
        state.check(_like(state))
        stands = int(state.stands)
        fresh = _no_scans(_PENDING if stands == IN_SCANS else 0)
        for name, own in fresh._asdict().items():
            kept = getattr(state, name)
            own[: len(kept)] = kept
        of_signals = [getattr(state, name) for name in _OF_SIGNALS]
        back = Changed(state.back_signal, state.back_value, state.back_status, state.back_time)
        self.stands, self._back, self._scans = stands, back, fresh
        self._looked_at = len(back.time)
        self.found = None
        if stands == IN_SCANS:
            period, window = int(state.period), int(state.window)
            comes, offset, limit, jitter, deadband = of_signals
            self.found = Found(comes, offset, limit, jitter, period, window, deadband)


def make_one_scan() -> None:
    """Compile the loop that makes scans."""
    valve = ValveTiming(TimingSettings(), optional=(), has_sequence=False)
    valve.put(replace(valve.state, stands=np.array(IN_SCANS)))
    valve.take(NOTHING, flush=True)


NOTHING = Changed(np.empty(0, np.int64), np.empty(0), np.empty(0, np.uint32), np.empty(0, np.int64))
_NOT_FOUND = Found(
    comes=np.zeros(PER_VALVE, np.int64),
    offset=np.zeros(PER_VALVE, np.int64),
    limit=np.zeros(PER_VALVE),
    jitter=np.zeros(PER_VALVE),
    period=0,
    window=0,
)


def _like(state: TimingState) -> TimingState:
    """Return an initial state with as many buffered changes as ``state``."""
    waiting, back = (np.size(array) for array in (state.time, state.back_time))
    if waiting > (_PENDING if np.all(state.stands == IN_SCANS) else 0):
        raise StateMismatchError("more is on its way than can be")
    scans = _no_scans(waiting)
    scans.course[kernel.SIZE] = waiting
    held_back = dict(zip(_BACK, _room(back), strict=True))
    return replace(_NOTHING_SEEN, **scans._asdict(), **held_back)


def _no_scans(room: int) -> Scans:
    n = PER_VALVE
    return Scans(
        time=np.zeros(room, np.int64),
        signal=np.zeros(room, np.int64),
        value=np.zeros(room),
        status=np.zeros(room, np.uint32),
        now_value=np.zeros(n),
        now_status=np.zeros(n, np.uint32),
        now_time=np.full(n, NEVER),
        now_rate=np.full(n, np.inf),
        seen=np.full(n, NEVER),
        lacking=np.zeros(n, np.int64),
        moved=np.zeros(n, np.int64),
        course=np.array([0, NEVER, NEVER, 0, 0], np.int64),
    )


def _room(n: int) -> Changed:
    return Changed(
        np.empty(n, np.int64), np.empty(n), np.empty(n, np.uint32), np.empty(n, np.int64)
    )


def _part(changes: Changed, start: int, stop: int) -> Changed:
    return Changed._make(column[start:stop] for column in changes)


def _without_first(changes: Changed, count: int) -> Changed:
    """Drop the oldest ``count`` changes, except the newest of each signal among them."""
    signal = changes.signal[:count]
    last = [int(own[-1]) for j in np.unique(signal) if len(own := np.flatnonzero(signal == j))]
    rows = np.array([*sorted(last), *range(count, len(changes.signal))], np.int64)
    return Changed._make(column[rows] for column in changes)


def _joined(first: Changed, second: Changed) -> Changed:
    return Changed(
        np.concatenate((first.signal, second.signal)),
        np.concatenate((first.value, second.value)),
        np.concatenate((first.status, second.status)),
        np.concatenate((first.time, second.time)),
    )


_NOTHING_SEEN: Final = ValveTiming(TimingSettings(), optional=(), has_sequence=False).state
