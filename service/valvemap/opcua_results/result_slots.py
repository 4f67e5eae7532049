"""The slots of the valves that are shown, stable across reloads. Pure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Times
from valvemap.pipeline.results import ValveDescription


@dataclass(frozen=True)
class Changeover:
    """The changes of a reload to the valves that are shown.

    ``before`` and ``after`` are all valves. A valve whose description changed is in ``gone``, by
    name, and in ``came``. ``kept`` are the slots of the unchanged valves, (K,).
    """

    before: Sequence[ValveDescription]
    after: Sequence[ValveDescription]
    gone: frozenset[str]
    came: Sequence[ValveDescription]
    kept: NDArray[np.intp]


class ValveSlots:
    """Row numbers (slots) of per-valve state; a slot is never reused.

    An operator numbers its valves from 0. Numbers and slots are equal until the first reload.

    Parameters
    ----------
    valves
        The first operator's valves, by number.

    >>> boom, stick = ValveDescription("Boom", ()), ValveDescription("Stick", ())
    >>> slots = ValveSlots([boom, stick])
    >>> came = slots.follow([stick, ValveDescription("Bucket", ())]).came
    >>> slots.of(np.array([0, 1])).tolist(), slots.names, slots.by_name.get("Boom")
    ([1, 2], ['Boom', 'Stick', 'Bucket'], None)
    """

    def __init__(self, valves: Sequence[ValveDescription]) -> None:
        self._valves = list(valves)  # by slot, removed valves included
        self._slots = {valve.name: slot for slot, valve in enumerate(self._valves)}
        self._slot_of = np.arange(len(self._valves))  # of each of the operator's valves

    def __len__(self) -> int:
        """Number of slots, those of removed valves included."""
        return len(self._valves)

    def __getitem__(self, slot: int) -> ValveDescription:
        """The valve of a slot, even if it was removed."""
        return self._valves[slot]

    @property
    def names(self) -> list[str]:
        """Names of the valves by slot, removed valves included."""
        return [valve.name for valve in self._valves]

    @property
    def by_name(self) -> Mapping[str, int]:
        """The slots of the valves that are shown now."""
        return self._slots

    @property
    def shown(self) -> list[ValveDescription]:
        """The valves that are shown now."""
        return [self._valves[slot] for slot in self._slots.values()]

    @property
    def most_counters(self) -> int:
        """The largest number of counters of any valve."""
        return max((len(valve.counters) for valve in self._valves), default=0)

    @property
    def every(self) -> NDArray[np.intp]:
        """The slots of all of the operator's valves, by number."""
        return self._slot_of

    def of(self, numbers: Times) -> NDArray[np.intp]:
        """Return the slots of the operator's valves with the given numbers, (M,)."""
        return self._slot_of[numbers]

    def number(self, name: str) -> int:
        """Return the operator's number of a valve that is shown."""
        return int(np.flatnonzero(self._slot_of == self._slots[name])[0])

    def follow(self, valves: Sequence[ValveDescription]) -> Changeover:
        """Switch to another operator's valves; added valves get the next slots."""
        before, first_new = self.shown, len(self._valves)
        after = {valve.name: valve for valve in valves}
        gone = frozenset(valve.name for valve in before if after.get(valve.name) != valve)
        for name in gone:
            del self._slots[name]
        came = [valve for valve in valves if valve.name not in self._slots]
        self._valves += came
        self._slots |= {valve.name: first_new + k for k, valve in enumerate(came)}
        self._slot_of = np.array([self._slots[valve.name] for valve in valves], np.intp)
        kept = self._slot_of[self._slot_of < first_new]
        return Changeover(before, valves, gone, came, kept)
