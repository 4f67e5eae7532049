"""The arrivals of all valves together as bytes: waiting samples, and the detected timing. Pure.

:mod:`~valvemap.pipeline.kept_arrivals` has those of one valve.
"""

import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from valvemap.model.estimator import State, StateMismatchError, key_of
from valvemap.pipeline.alignment import Alignment, AlignmentSettings, optional_in_keys
from valvemap.pipeline.kept_waiting import contents_of_waiting
from valvemap.pipeline.kernels import waiting as slots
from valvemap.pipeline.kernels.waiting import Waiting
from valvemap.pipeline.timing import Timing, TimingSettings, TimingState
from valvemap.pipeline.timing_state import ALIKE

_BY_SLOT: Final = ("slots", "values", "status")
_DIGEST_BYTES: Final = 4


def key_of_arrivals(names: Sequence[str], alignment: Alignment, timing: Timing | None) -> str:
    """Return the hash that states are bound to; ``timing``: None if it is configured."""
    return key_of(
        _Key(
            tuple(names),
            alignment.settings,
            tuple(map(optional_in_keys, alignment.optional)),
            alignment.has_sequence,
            None if timing is None else timing.settings,
        )
    )


def pack(waiting: Waiting, timing: Timing, key: str) -> bytes:
    """Pack the state of all valves."""
    size = int(waiting.order[:, slots.SIZE].max(initial=0))
    arrays = {
        name: array[:, :size] if name in _BY_SLOT else array
        for name, array in waiting._asdict().items()
    }
    packed_waiting = _Kept(**arrays).to_bytes(key)
    special = [
        (number, valve.state.to_bytes(key))
        for number, valve in enumerate(timing.valves)
        if valve.stands != ALIKE
    ]
    sizes = [len(packed_waiting), [(n, len(packed)) for n, packed in special]]
    head = json.dumps(sizes).encode()
    body = b"".join((head, b"\n", packed_waiting, *(packed for _, packed in special)))
    return zlib.crc32(body).to_bytes(_DIGEST_BYTES, "big") + body


def unpack(
    packed: bytes, key: str, valves: int, alignment: Alignment
) -> tuple[Waiting, dict[int, TimingState]]:
    """Return what waits of this number of valves, and their timing as far as it is not `ALIKE`.

    Raises
    ------
    StateMismatchError
        if it is damaged, or the configuration differs.
    """
    digest, body = packed[:_DIGEST_BYTES], packed[_DIGEST_BYTES:]
    if zlib.crc32(body).to_bytes(_DIGEST_BYTES, "big") != digest:
        raise StateMismatchError("damaged")
    head, _, rest = body.partition(b"\n")
    try:
        size, special = json.loads(head)
        at = size = int(size)
        lengths = [(int(number), int(length)) for number, length in special]
    except (ValueError, TypeError, OverflowError, RecursionError) as error:
        raise StateMismatchError(f"not the head of an alignment's state: {error}") from error
    kept = _Kept.from_bytes(rest[:size], key)
    waiting = Waiting(*(np.asarray(getattr(kept, name)) for name in Waiting._fields))
    _check(waiting, valves, alignment)
    states = {}
    for number, length in lengths:
        states[number] = TimingState.from_bytes(rest[at : at + length], key)
        at += length
    return waiting, states


@dataclass(frozen=True)
class _Kept(State):
    """The alignment's state of all valves."""

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
    """The configuration that the state is bound to."""

    names: tuple[str, ...]
    alignment: AlignmentSettings
    has_T: tuple[bool | tuple[str, ...], ...]
    has_sequence: tuple[bool, ...]
    timing: TimingSettings | None


def _check(waiting: Waiting, valves: int, alignment: Alignment) -> None:
    """Raise if the shapes or contents are invalid for these valves."""
    pending = waiting.slots.shape[1] if waiting.slots.ndim > 1 else 0
    like = alignment.nothing(valves, pending)
    sizes = waiting.order[:, slots.SIZE] if waiting.order.shape == like.order.shape else ()
    if len(sizes) and min(sizes) >= 0 and max(sizes) <= pending:
        like.order[:, slots.SIZE] = sizes
    for name, contents in contents_of_waiting(like).items():
        wrong = contents.wrong_in(getattr(waiting, name))
        if wrong is not None:
            raise StateMismatchError(f"{name} {wrong}")
