"""Which samples of a block are changes for its monitored items: they differ from the last reports.

The rules are those of ``data_change``; the tests compare both byte by byte.
"""

from typing import Any

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from guarded_opcua.address_space.batches import Batch, Bools
from guarded_opcua.address_space.blocks import Block
from guarded_opcua.monitoring.block_queue import Slots
from guarded_opcua.monitoring.data_change import ChangeRule

_Trigger = ua.DataChangeTrigger
_Pair = tuple[NDArray[Any], NDArray[Any]]


class BlockChanges:
    """The rules of items, and their last reported values; arrays (slots,)."""

    def __init__(self, block: Block) -> None:
        self._block = block
        self._trigger = np.zeros(0, np.int8)
        self._deadband = np.zeros(0)
        self._reported = np.zeros(0, np.bool_)
        self._values = np.zeros((0, block.width), block.dtype)
        self._codes = np.zeros(0, np.uint32)
        self._has = np.zeros(0, np.bool_)
        self._source = np.zeros(0, np.int64)

    def set_rule(self, slot: int, rule: ChangeRule) -> None:
        """Set the rule of an item."""
        self._trigger[slot], self._deadband[slot] = rule.trigger, rule.deadband

    def forget(self, slot: int) -> None:
        """Reset the reported values: the next sample is a change."""
        self._reported[slot] = False

    def last(self, slot: int) -> ua.DataValue | None:
        """Return the last reported value of an item, if any."""
        if not self._reported[slot]:
            return None
        return self._block.data_value(
            self._values[slot],
            int(self._codes[slot]),
            bool(self._has[slot]),
            int(self._source[slot]),
            0,
        )

    def find(self, batch: Batch, slots: Slots) -> Bools:
        """Return which samples are changes, shape (k, slots), and note them as reported."""
        if batch.present is None and not self._deadband[slots].any():
            return self._changes_of_all(batch, slots)
        changed = np.zeros(batch.codes.shape, np.bool_)
        for row in range(len(batch)):
            one = self._is_change(
                slots,
                ~self._reported[slots],
                (self._values[slots], batch.values[row]),
                (self._codes[slots], batch.codes[row]),
                (self._has[slots], batch.has[row]),
                (self._source[slots], batch.source[row]),
            )
            if batch.present is not None:
                one &= batch.present[row]
            self._remember(slots[one], batch, row, np.flatnonzero(one))
            changed[row] = one
        return changed

    def _changes_of_all(self, batch: Batch, slots: Slots) -> Bools:
        """Return the changes without a deadband, by comparing each sample with the one before."""
        unreported = np.zeros(batch.codes.shape, np.bool_)
        unreported[0] = ~self._reported[slots]
        changed = self._is_change(
            slots,
            unreported,
            (np.concatenate((self._values[None, slots], batch.values[:-1])), batch.values),
            (np.concatenate((self._codes[None, slots], batch.codes[:-1])), batch.codes),
            (np.concatenate((self._has[None, slots], batch.has[:-1])), batch.has),
            (np.concatenate((self._source[None, slots], batch.source[:-1])), batch.source),
        )
        if changed[-1].all():
            self._remember(slots, batch, -1, slice(None))
        else:
            which = np.flatnonzero(changed.any(axis=0))
            last = len(batch) - 1 - np.argmax(changed[::-1, which], axis=0)
            self._remember(slots[which], batch, last, which)
        return changed

    def _is_change(
        self,
        slots: Slots,
        unreported: Bools,
        values: _Pair,
        codes: _Pair,
        has: _Pair,
        source: _Pair,
    ) -> Bools:
        """Compare reported with new values; shapes (slots, …) or (k, slots, …)."""
        trigger, deadband = self._trigger[slots], self._deadband[slots]
        old, new = values
        differs = old != new
        if deadband.any():
            with np.errstate(invalid="ignore"):
                far = np.abs(new - old)
            beyond = np.where(np.isnan(far), differs, far > deadband[:, None])
            differs = np.where(deadband[:, None] > 0.0, beyond, differs)
        if self._block.dtype.kind == "f":
            differs &= ~(np.isnan(old) & np.isnan(new))
        differs = differs[..., 0] if differs.shape[-1] == 1 else differs.any(axis=-1)
        differs = (differs & has[1]) | (has[0] != has[1])
        differs |= (trigger == _Trigger.StatusValueTimestamp) & (source[0] != source[1])
        differs &= trigger != _Trigger.Status
        return differs | (codes[0] != codes[1]) | unreported

    def _remember(self, slots: Slots, batch: Batch, row: int | Slots, which: Slots | slice) -> None:
        self._reported[slots] = True
        self._values[slots] = batch.values[row, which]
        self._codes[slots] = batch.codes[row, which]
        self._has[slots] = batch.has[row, which]
        self._source[slots] = batch.source[row, which]

    def grow(self, size: int) -> None:
        """Add free slots, up to this number."""
        for name, held in vars(self).items():
            if isinstance(held, np.ndarray):
                setattr(self, name, grown(held, size))


def grown(held: NDArray[Any], size: int) -> NDArray[Any]:
    """Return an array with further rows of 0, up to this number."""
    return np.concatenate((held, np.zeros((size - len(held), *held.shape[1:]), held.dtype)))
