"""Recordings in long format: a row per value, with its time and the name of its signal."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Floats, Times
from valvemap.plant.names import tokens
from valvemap.storage.headings import time_column

MOST_ROWS: Final = 20_000_000  # values of a file; they are sorted in memory
_VALUE_WORDS: Final = frozenset(
    {"value", "wert", "messwert", "valeur", "valor", "valore", "值", "数值"}
)
_MOST_TAGS: Final = 200
_LEAST_REPEATS: Final = 2  # rows per tag at the beginning of a file, on average


@dataclass(frozen=True)
class LongColumns:
    """The columns of times, names and values."""

    time: int
    tag: int
    value: int


def long_columns(
    headings: Sequence[str], rows: Sequence[Sequence[str]], numeric: Sequence[bool]
) -> LongColumns | None:
    """Return the columns of a file in long format, None if it is in none.

    >>> rows = [["0", "p1", "180"], ["0", "Q", "30"], ["1", "p1", "181"], ["1", "Q", "31"]]
    >>> long_columns(["time", "tag", "value"], rows, [True, False, True])
    LongColumns(time=0, tag=1, value=2)
    """
    time = time_column(headings, numeric)
    if time is None:
        return None
    texts = [n for n, is_number in enumerate(numeric) if not is_number and n != time]
    values = [n for n, is_number in enumerate(numeric) if is_number and n != time]
    named = [n for n in values if _VALUE_WORDS & set(tokens(headings[n]))]
    chosen = named or values
    tags = [n for n in texts if _are_tags([row[n] for row in rows])]
    if not tags or len(chosen) != 1:
        return None
    return LongColumns(time, tags[0], chosen[0])


def pivot(times: Times, tag: NDArray[np.intp], values: Floats, tags: int) -> tuple[Times, Floats]:
    """Return distinct times (M,), and the values of each tag (M, tags), held from its last one.

    Rows before the first value of a tag hold NaN in its column.

    >>> t, table = pivot(np.array([0, 0, 5]), np.array([0, 1, 0]), np.array([1.0, 2.0, 3.0]), 2)
    >>> t.tolist(), table.tolist()
    ([0, 5], [[1.0, 2.0], [3.0, 2.0]])
    """
    distinct, row = np.unique(times, return_inverse=True)
    table = np.full((len(distinct), tags), np.nan)
    there = np.zeros((len(distinct), tags), np.bool_)
    table[row, tag] = values
    there[row, tag] = True
    newest = np.maximum.accumulate(np.where(there, np.arange(len(distinct))[:, None], -1), axis=0)
    held = np.take_along_axis(table, np.maximum(newest, 0), axis=0)
    return distinct, np.where(newest >= 0, held, np.nan)


def _are_tags(cells: Sequence[str]) -> bool:
    distinct = len(set(cells))
    return 1 < distinct <= _MOST_TAGS and len(cells) >= _LEAST_REPEATS * distinct
