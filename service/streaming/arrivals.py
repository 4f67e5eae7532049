"""Data changes of many valves on their way into samples: timing first, then alignment. Pure."""

import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from service.identification.estimator import State, StateMismatchError, key_of
from service.identification.samples import Times
from service.streaming.alignment import Alignment, AlignmentSettings, ByValve
from service.streaming.data_changes import DataChanges
from service.streaming.kernels import waiting as slots
from service.streaming.kernels.waiting import Waiting
from service.streaming.timing import Timing, TimingSettings, TimingState
from service.streaming.valve_timing import ALIKE

_BY_SLOT: Final = ("slots", "values", "status")
_DIGEST_BYTES: Final = 4


@dataclass(frozen=True)
class _Kept(State):
    """What waits at all valves."""

    slots: Any
    values: Any
    status: Any
    held_value: Any
    held_status: Any
    held_time: Any
    lost: Any
    left: Any
    order: Any
    counters: Any


@dataclass(frozen=True)
class _Key:
    """What it depends on how changes become samples."""

    names: tuple[str, ...]
    alignment: AlignmentSettings
    has_T: tuple[bool, ...]
    has_sequence: tuple[bool, ...]
    timing: TimingSettings | None


class Arrivals:
    """Makes samples of changes; what is under way can be kept, to the bit.

    Parameters
    ----------
    names
        Of the valves.
    alignment, timing
        How their signals find together, and how it is found in what way they come (None: it is
        configured).

    Examples
    --------
    >>> arrivals = Arrivals(["V1"], Alignment(AlignmentSettings(), has_T=(False,)))
    >>> len(arrivals.take(DataChanges.empty()))
    0
    """

    def __init__(
        self, names: Sequence[str], alignment: Alignment, timing: Timing | None = None
    ) -> None:
        self.names = tuple(names)
        self._alignment = alignment
        self._waiting = alignment.initial_state()
        self.timing = timing or Timing(TimingSettings(), alignment.has_T, fixed=True)
        self._key = key_of(
            _Key(
                self.names,
                alignment.settings,
                alignment.has_T,
                alignment.has_sequence,
                None if timing is None else timing.settings,
            )
        )

    def take(self, changes: DataChanges) -> ByValve:
        """Take changes in; return the samples that they completed."""
        return self._align(self.timing.take(changes))

    def waits(self) -> NDArray[np.bool_]:
        """Which valves have samples that wait for earlier ones."""
        return self._alignment.waits(self._waiting) | (self.timing.pending > 0)

    def wait_no_longer(self, valves: Times) -> ByValve:
        """What waits for earlier samples, without them."""
        unfinished = self.timing.flush(valves)
        if len(unfinished):
            return self._align(unfinished)
        return self._flush(valves)

    def begin_source_anew(self, valves: Times) -> ByValve:
        """The source of some valves was restarted: its running numbers begin anew."""
        self._waiting, samples = self._alignment.begin_anew(self._waiting, valves)
        return samples

    def finish(self) -> list[ByValve]:
        """All that waits, whatever for."""
        every = np.arange(len(self.names))
        return [self._align(self.timing.flush(every)), self._flush(every)]

    def to_bytes(self) -> bytes:
        """Pack what is under way."""
        size = int(self._waiting.order[:, slots.SIZE].max(initial=0))
        arrays = {
            name: array[:, :size] if name in _BY_SLOT else array
            for name, array in self._waiting._asdict().items()
        }
        waiting = _Kept(**arrays).to_bytes(self._key)
        special = [
            (number, valve.state.to_bytes(self._key))
            for number, valve in enumerate(self.timing.valves)
            if valve.stands != ALIKE
        ]
        head = json.dumps([len(waiting), [(n, len(packed)) for n, packed in special]]).encode()
        body = b"".join((head, b"\n", waiting, *(packed for _, packed in special)))
        return zlib.crc32(body).to_bytes(_DIGEST_BYTES, "big") + body

    def resume(self, packed: bytes) -> None:
        """Go on from what was under way.

        Raises
        ------
        StateMismatchError
            if it is damaged, or of valves that are configured otherwise; nothing is changed then.
        """
        digest, body = packed[:_DIGEST_BYTES], packed[_DIGEST_BYTES:]
        if zlib.crc32(body).to_bytes(_DIGEST_BYTES, "big") != digest:
            raise StateMismatchError("damaged")
        head, _, rest = body.partition(b"\n")
        size, special = json.loads(head)
        kept = _Kept.from_bytes(rest[:size], self._key)
        waiting = Waiting(*(getattr(kept, name) for name in Waiting._fields))
        states, at = {}, size
        for number, length in special:
            states[number] = TimingState.from_bytes(rest[at : at + length], self._key)
            at += length
        for number in range(len(self.names)):
            one = self._alignment.of(waiting, number)
            self._waiting = self._alignment.put(self._waiting, number, one)
            self.timing.put(number, states.get(number, _ALIKE))

    def _align(self, changes: DataChanges) -> ByValve:
        self._waiting, samples = self._alignment.take(self._waiting, changes)
        return samples

    def _flush(self, valves: Times) -> ByValve:
        self._waiting, samples = self._alignment.flush(self._waiting, valves)
        return samples


_ALIKE: Final = Timing(TimingSettings(), (False,), fixed=True).valves[0].state
