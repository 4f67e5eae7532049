"""The state of valves as columns: arrays whose first axis is valves. Pure.

Columns with the same key have the same layout and meaning, independent of the other valves. So a
valve's row can be copied into the columns of another configuration.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray


@dataclass(frozen=True)
class Columns:
    """State of several valves under one key.

    Attributes
    ----------
    key
        Name of the part, and the hash of its hyper-parameters.
    valves
        Names, one for each row.
    arrays
        By name, each (len(valves), …); updated in place by their owner.
    """

    key: str
    valves: tuple[str, ...]
    arrays: Mapping[str, NDArray[Any]]


def copy_rows(kept: Iterable[Columns], own: Sequence[Columns]) -> set[tuple[str, str]]:
    """Copy the row of each valve that has one under the same key; return those that have none.

    Parameters
    ----------
    kept
        The previous columns.
    own
        The present columns, updated in place.

    Returns
    -------
    set of (key, valve)
        of ``own`` without a previous row of the same shapes and types.

    Examples
    --------
    >>> import numpy as np
    >>> now = Columns("gate 1", ("b", "c"), {"n": np.zeros(2)})
    >>> copy_rows([Columns("gate 1", ("a", "b"), {"n": np.array([1.0, 2.0])})], [now])
    {('gate 1', 'c')}
    >>> now.arrays["n"]
    array([2., 0.])
    """
    known = {
        (columns.key, valve): (columns, row)
        for columns in kept
        for row, valve in enumerate(columns.valves)
    }
    none: set[tuple[str, str]] = set()
    for columns in own:
        rows: dict[int, tuple[Columns, list[int], list[int]]] = {}
        for row, valve in enumerate(columns.valves):
            before, place = known.get((columns.key, valve), (None, 0))
            if before is None or not _is_like(before, columns):
                none.add((columns.key, valve))
                continue
            _, here, there = rows.setdefault(id(before), (before, [], []))
            here.append(row)
            there.append(place)
        for before, here, there in rows.values():
            for name, array in columns.arrays.items():
                array[here] = before.arrays[name][there]
    return none


def _is_like(one: Columns, other: Columns) -> bool:
    return one.arrays.keys() == other.arrays.keys() and all(
        one.arrays[name].shape[1:] == array.shape[1:] and one.arrays[name].dtype == array.dtype
        for name, array in other.arrays.items()
    )
