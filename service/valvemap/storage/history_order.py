"""Rows of a series in order of time, from blocks that may overlap, since rows may come late."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Floats, Times
from valvemap.pipeline.store_ports import Past

Span = tuple[int, int, Past]
"""First and last time of a block, and the rows of it that are asked for."""


def nothing() -> Past:
    """Return no rows."""
    return Past(np.empty(0, np.int64), np.empty(0), np.empty(0, np.uint32))


def in_order(blocks: Iterable[Span], *, backwards: bool) -> Iterator[Past]:
    """Yield the rows of blocks by time; ``blocks`` come by first time, or backwards by last.

    A row is yielded as soon as no further block can hold one before it.
    """
    waiting = nothing()
    for first, last, rows in blocks:
        if len(waiting.t):
            if backwards:
                place = int(np.searchsorted(waiting.t, last, side="right"))
                yield waiting[place:][::-1]
                waiting = waiting[:place]
            else:
                place = int(np.searchsorted(waiting.t, first))
                yield waiting[:place]
                waiting = waiting[place:]
        waiting = merged([waiting, rows])
    yield waiting[::-1] if backwards else waiting


def merged(parts: Sequence[Past]) -> Past:
    """Return the rows of all parts by time; of equal times, those of the earlier part first."""
    found = joined([part for part in parts if len(part.t)])
    if (np.diff(found.t) >= 0).all():
        return found
    order = np.argsort(found.t, kind="stable")
    return Past(found.t[order], found.values[order], found.codes[order])


def joined(parts: Sequence[Past]) -> Past:
    """Return the rows of all parts, one after another."""
    if not parts:
        return nothing()
    columns: list[tuple[Times, Floats, NDArray[np.uint32]]] = [
        (past.t, past.values, past.codes) for past in parts
    ]
    t, values, codes = (np.concatenate(column) for column in zip(*columns, strict=True))
    return Past(t, values, codes)
