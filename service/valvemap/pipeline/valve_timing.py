"""Timing of one valve's signals: detected from the first changes, then fixed.

Signals with the same timestamp pass unchanged. Others are held back until their timing is detected
(:mod:`valvemap.pipeline.scan_search`), then converted into scans of one time each
(:mod:`valvemap.pipeline.kernels.scans`), the held-back changes first. The result does not depend on
how the changes are cut into batches, but for the batch at whose end a command is found at rest
(:mod:`valvemap.pipeline.command_rests`).
"""

from dataclasses import replace
from typing import Final

import numpy as np

from valvemap.model.estimator import StateMismatchError
from valvemap.model.samples import Times
from valvemap.pipeline.alignment import presence
from valvemap.pipeline.changed_columns import NOTHING, joined, no_scans, part, room, without_first
from valvemap.pipeline.kernels import scans as kernel
from valvemap.pipeline.kernels.scans import NEVER, Changed, ScanRules
from valvemap.pipeline.scan_search import (
    FEWEST_SCANS,
    NOT_FOUND,
    SHORTEST_WINDOW_NS,
    Comes,
    Found,
    find_scans,
    is_stamped_alike,
    only_changes,
)
from valvemap.pipeline.timing_listening import (
    MOST_HELD_BACK,
    has_one_instant,
    heard_long_enough,
)
from valvemap.pipeline.timing_state import (
    ALIKE,
    DOUBTFUL,
    IN_SCANS,
    LISTENING,
    TimingSettings,
    TimingState,
)
from valvemap.pipeline.timing_words import Words
from valvemap.vocabulary.signals import PER_VALVE, Signal

ENOUGH_PER_SIGNAL: Final = 20  # values until a source is accepted as using one timestamp
_PENDING: Final = 1024  # changes of a valve buffered for scans
_AGAIN: Final = 1.25  # growth of the held-back changes between two attempts at detection
_BACK: Final = ("back_signal", "back_value", "back_status", "back_time")
_OF_SIGNALS: Final = ("comes", "offset", "limit", "jitter", "deadband")


class ValveTiming:
    """Timing of one valve's signals."""

    def __init__(
        self,
        settings: TimingSettings,
        *,
        optional: tuple[str, ...],
        has_sequence: bool,
    ) -> None:
        self._settings = settings
        self._there = np.append(presence([optional])[0], has_sequence)
        self.stands = LISTENING
        self.found: Found | None = None
        self._back = NOTHING
        self._looked_at = 0
        self._scans = no_scans(0)  # most valves need no scans
        self._command_moves = True  # U was not seen again unchanged

    def take(self, changes: Changed, *, flush: bool = False) -> Changed:
        """Process changes; return those that are due, in the order of scans if there are any."""
        if self.stands == ALIKE:
            return changes
        if self.stands == IN_SCANS:
            return self._into_scans(changes, flush=flush)
        self._back = joined(self._back, changes)
        return self._listen(changes)

    def hold_command(self, command: float, newest: int, period: int) -> None:
        """Hold U from change to change from now on: ``command`` since before ``newest``.

        The signals had one timestamp so far, every ``period``; all are known up to ``newest``.
        """
        found = replace(NOT_FOUND, period=period, window=min(SHORTEST_WINDOW_NS, period // 4))
        comes = np.where(self._there, np.int64(Comes.WITH_THE_SCAN), np.int64(Comes.ABSENT))
        comes[Signal.U] = Comes.HELD
        self.found = replace(found, comes=comes, limit=np.full(PER_VALVE, np.inf))
        self.stands, self._back, self._scans = IN_SCANS, NOTHING, no_scans(_PENDING)
        self._scans.now_value[Signal.U] = command
        self._scans.now_time[Signal.U] = newest
        self._scans.seen[self._there] = newest
        self._scans.course[[kernel.NEWEST, kernel.LEFT]] = newest

    def _listen(self, newest: Changed) -> Changed:
        if self.stands == DOUBTFUL:
            return self._doubt(newest)
        while len(self._back.time) >= _AGAIN * self._looked_at:
            self._looked_at = len(self._back.time)
            end, heard = heard_long_enough(self._back, self._there, self._settings.horizon_ns)
            if has_one_instant(heard, self._there):
                self.stands = DOUBTFUL
                return self._doubt(self._back)
            if end < 0:
                break
            found = find_scans(heard, self._there)
            if found is not None:
                self._settle(found, heard)
                back, self._back = self._back, NOTHING
                return self._into_scans(back)
            self._back, self._looked_at = without_first(self._back, (end + 1) // 2), 0
        return NOTHING

    def _doubt(self, passed: Changed) -> Changed:
        """Decide whether most samples have one timestamp; until then changes pass unchanged."""
        back = self._back
        enough = ENOUGH_PER_SIGNAL * int(self._there.sum())
        if len(back.time) < enough:
            return passed
        if is_stamped_alike(part(back, 0, enough), self._there):
            self.stands, self._back = ALIKE, NOTHING
            return passed
        end, heard = heard_long_enough(self._back, self._there, self._settings.horizon_ns)
        if end < 0:
            if len(back.time) >= MOST_HELD_BACK:
                self.stands, self._back = ALIKE, NOTHING
            return passed
        found = find_scans(heard, self._there)
        if found is None:
            self.stands, self._back = ALIKE, NOTHING
            return passed
        self._settle(found, heard)
        rest = len(back.time) - end
        cut = max(len(passed.time) - rest, 0)
        self._into_scans(part(back, 0, end))
        self._scans.lacking[:] = self._scans.moved[:] = 0
        on = self._into_scans(part(back, end, len(back.time)))
        self._back = NOTHING
        return joined(part(passed, 0, cut), on)

    def _settle(self, found: Found, heard: Changed) -> None:
        self._command_moves = only_changes(heard, Signal.U)
        self.found, self.stands, self._scans = found, IN_SCANS, no_scans(_PENDING)

    def _into_scans(self, changes: Changed, *, flush: bool = False) -> Changed:
        found = self.found
        assert found is not None  # noqa: S101 - it stands in scans
        if self._command_rests(changes):
            found.comes[Signal.U], found.limit[Signal.U] = Comes.HELD, np.inf
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
        out = room(PER_VALVE * (len(changes.time) + waiting))
        n = kernel.make_scans(changes, flush, rules, self._scans, out)
        return part(out, 0, n)

    def _command_rests(self, changes: Changed) -> bool:
        """Whether U, once in every scan, is no longer sent while the other signals are."""
        found, scans = self.found, self._scans
        assert found is not None  # noqa: S101 - it stands in scans
        if not self._command_moves or found.comes[Signal.U] in (Comes.ABSENT, Comes.HELD):
            return False
        waiting = Changed(scans.signal, scans.value, scans.status, scans.time)
        both = joined(part(waiting, 0, self.pending), changes)
        own = both.signal == Signal.U
        self._command_moves = only_changes(both, Signal.U)
        newest = max(int(scans.seen[Signal.U]), int(both.time[own].max(initial=NEVER)))
        later = both.time[both.time > newest]
        if newest == NEVER or len(later) == 0 or later.max() - newest < self._settings.horizon_ns:
            return False
        often = np.bincount(both.signal[both.time > newest]).max()
        return bool(self._command_moves and often >= FEWEST_SCANS)

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
        found = self.found or NOT_FOUND
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
        fresh = no_scans(_PENDING if stands == IN_SCANS else 0)
        for name, own in fresh._asdict().items():
            kept = getattr(state, name)
            own[: len(kept)] = kept
        of_signals = [getattr(state, name) for name in _OF_SIGNALS]
        back = Changed(state.back_signal, state.back_value, state.back_status, state.back_time)
        self.stands, self._back, self._scans = stands, back, fresh
        self._command_moves = True
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


def _like(state: TimingState) -> TimingState:
    """Return an initial state with as many buffered changes as ``state``."""
    waiting, back = (np.size(array) for array in (state.time, state.back_time))
    if waiting > (_PENDING if np.all(state.stands == IN_SCANS) else 0):
        raise StateMismatchError("more is on its way than can be")
    scans = no_scans(waiting)
    scans.course[kernel.SIZE] = waiting
    held_back = dict(zip(_BACK, room(back), strict=True))
    return replace(_NOTHING_SEEN, **scans._asdict(), **held_back)


_NOTHING_SEEN: Final = ValveTiming(TimingSettings(), optional=(), has_sequence=False).state
