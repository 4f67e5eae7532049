"""Packs columns of doubles and integers without loss, bit by bit.

A column of measurements is mostly a multiple of a step (a converter's resolution, the decimals of a
recording): value = k · step, rounded to a double, or to a single that was widened to a double. The
packed form has the differences of successive k, and the difference in bits to the true value, which
is zero except for NaN, −0.0 and values beside the grid. A column without a step is packed as the
differences of its bits. A column that follows from others of its block (dp = p1 − p2, or
residual = k · step − prediction) is packed as the difference to that. Integers are split into
planes of bytes; each is one byte if constant, deflated if that saves space, and plain otherwise.
"""

import struct
from collections.abc import Callable, Mapping
from itertools import permutations
from typing import Final

import numpy as np

from valvemap.model.samples import Floats, Times
from valvemap.storage.byte_planes import (
    Integers,
    byte_at,
    packed_integers,
    slice_of,
    unpacked_integers,
)

MAGIC: Final = b"\xf7vmp"
MOST_ROWS: Final = 1 << 21  # of a column; more are not unpacked

_HEADER: Final = struct.Struct("<4sBI")  # magic, form, rows
_STEP: Final = struct.Struct("<d")
_BITS, _STEPS, _SINGLE_STEPS, _TIMES, _OF_OTHERS = range(5)
_PROBE: Final = 256  # rows on which steps and other columns are tried
_ENOUGH: Final = 0.9  # of these must fit
_FIT: Final = 1e-7  # of a step; a value on the grid is as near to it
_STEPS_TRIED: Final = tuple(10.0**-e for e in range(7))
_MOST_STEPS: Final = 2.0**50
Others = Callable[[str], Floats]


def is_packed(data: bytes) -> bool:
    """Whether bytes start as a packed column does."""
    return data.startswith(MAGIC)


def pack_doubles(values: Floats, others: Mapping[str, Floats] | None = None) -> bytes:
    """Return doubles (n,) packed; `unpack_doubles` returns the same bits.

    ``others`` are columns (n,) by name from which these may follow.

    >>> column = np.array([20.01, 20.02, -0.0, np.nan])
    >>> unpack_doubles(pack_doubles(column)).tobytes() == column.tobytes()
    True
    """
    values = np.ascontiguousarray(values, np.float64)
    n, given = len(values), others or {}
    if pair := _difference_of(values, given):
        beside = _bits(values) - _bits(given[pair[0]] - given[pair[1]])
        return _HEADER.pack(MAGIC, _OF_OTHERS, n) + _naming(0.0, pair) + packed_integers(beside)
    found = _step_of(values)
    if found is not None:
        form, step = found
        k = _counted(values, step)
        beside = _bits(values) - _bits(_on_grid(k, step, form))
        header = _HEADER.pack(MAGIC, form, n) + _STEP.pack(step)
        return header + packed_integers(_differences(k)) + packed_integers(beside)
    if sum_of := _sum_with(values, given):
        name, step = sum_of
        k = _counted(_sum(values, given[name]), step)
        beside = _bits(values) - _bits(_on_grid(k, step, _STEPS) - given[name])
        header = _HEADER.pack(MAGIC, _OF_OTHERS, n) + _naming(step, (name,))
        return header + packed_integers(_differences(k)) + packed_integers(beside)
    return _HEADER.pack(MAGIC, _BITS, n) + packed_integers(_differences(_bits(values)))


def unpack_doubles(data: bytes, others: Others | None = None) -> Floats:
    """Return packed doubles (n,); ``others`` returns the columns named by `others_of`.

    Raises
    ------
    ValueError
        if the bytes are no packed column of doubles, or ``others`` do not fit it.
    """
    form, n = _header(data)
    at = _HEADER.size
    if form == _BITS:
        found, at = unpacked_integers(data, at, n)
        bits = np.cumsum(found)
    elif form in (_STEPS, _SINGLE_STEPS):
        (step,) = _STEP.unpack(slice_of(data, at, _STEP.size))
        differences, at = unpacked_integers(data, at + _STEP.size, n)
        beside, at = unpacked_integers(data, at, n)
        bits = _bits(_on_grid(np.cumsum(differences), step, form)) + beside
    elif form == _OF_OTHERS:
        step, names, at = _named(data)
        columns = [others(name) for name in names] if others else []
        if not columns or any(len(column) != n for column in columns):
            raise ValueError("the columns that it follows from are missing")
        with np.errstate(all="ignore"):
            if len(columns) == 1:
                differences, at = unpacked_integers(data, at, n)
                near = _on_grid(np.cumsum(differences), step, _STEPS) - columns[0]
            else:
                near = columns[0] - columns[1]
        beside, at = unpacked_integers(data, at, n)
        bits = _bits(near) + beside
    else:
        raise ValueError(f"form {form} is not one of doubles")
    if at != len(data):
        raise ValueError("longer than its rows")
    return bits.view(np.float64)


def others_of(data: bytes) -> tuple[str, ...]:
    """Return the names of the columns from which a packed one follows; ValueError if damaged."""
    return _named(data)[1] if _header(data)[0] == _OF_OTHERS else ()


def pack_integers(values: Integers) -> bytes:
    """Return integers (n,), such as times, packed as the differences of their differences."""
    values = np.ascontiguousarray(values, np.int64)
    header = _HEADER.pack(MAGIC, _TIMES, len(values))
    first = _differences(values)
    base = int(first[1]) if len(values) > 1 else 0
    unit = int(np.gcd.reduce(first[1:] - base)) or 1
    start = int(values[0]) if len(values) else 0
    counted = np.concatenate([[0], (first[1:] - base) // unit]) if len(values) else first
    return header + struct.pack("<qqq", start, base, unit) + packed_integers(_differences(counted))


def unpack_integers(data: bytes) -> Times:
    """Return packed integers (n,), as `unpack_doubles`."""
    form, n = _header(data)
    at = _HEADER.size + 24
    if form != _TIMES:
        raise ValueError(f"form {form} is not one of integers")
    start, base, unit = struct.unpack("<qqq", slice_of(data, _HEADER.size, 24))
    second, at = unpacked_integers(data, at, n)
    if at != len(data):
        raise ValueError("longer than its rows")
    first = np.cumsum(second) * np.int64(unit) + np.int64(base)
    first[:1] = start
    return np.cumsum(first)


def rows_of(data: bytes) -> int:
    """Return the number of rows that a packed column announces; ValueError if it has no header."""
    return _header(data)[1]


def _header(data: bytes) -> tuple[int, int]:
    if len(data) < _HEADER.size:
        raise ValueError("cut short")
    magic, form, n = _HEADER.unpack_from(data)
    if magic != MAGIC or n > MOST_ROWS:
        raise ValueError("no packed column, or longer than any block")
    return form, n


def _probe(values: Floats) -> Floats:
    return values[:: max(len(values) // _PROBE, 1)]


def _step_of(values: Floats) -> tuple[int, float] | None:
    """Return the form and the largest step of which nearly all values are multiples, or None."""
    probe = _probe(values)
    probe = probe[np.isfinite(probe)]
    if not len(probe):
        return (_STEPS, 1.0) if not np.isfinite(values).any() else None
    with np.errstate(over="ignore"):
        is_single = (probe.astype(np.float32) == probe).all()
    for step in _STEPS_TRIED:
        for form in (_STEPS, _SINGLE_STEPS)[: 1 + is_single]:
            beside = np.abs(_on_grid(_counted(probe, step), step, form) - probe)
            if (beside <= _FIT * step).mean() >= _ENOUGH:
                return form, step
    return None


def _difference_of(values: Floats, others: Mapping[str, Floats]) -> tuple[str, str] | None:
    """Return the two columns whose difference nearly all values are, or None."""
    probe = _bits(_probe(values))
    probes = {name: _probe(column) for name, column in others.items()}
    with np.errstate(all="ignore"):
        for one, other in permutations(probes, 2):
            near = _bits(probes[one] - probes[other]) == probe
            if near[:8].any() and near.mean() >= _ENOUGH:
                return one, other
    return None


def _sum_with(values: Floats, others: Mapping[str, Floats]) -> tuple[str, float] | None:
    """Return the column whose sum with nearly all values is a multiple of a step, or None."""
    for name, other in others.items():
        if (found := _step_of(_sum(_probe(values), _probe(other)))) and found[0] == _STEPS:
            return name, found[1]
    return None


def _sum(values: Floats, other: Floats) -> Floats:
    with np.errstate(all="ignore"):
        return values + other


def _naming(step: float, names: tuple[str, ...]) -> bytes:
    texts = [name.encode("utf-8", "replace") for name in names]
    sizes = bytes([len(texts), *map(len, texts)])
    return _STEP.pack(step) + sizes + b"".join(texts)


def _named(data: bytes) -> tuple[float, tuple[str, ...], int]:
    """Return step and names of a column that follows from others, and the place behind them."""
    at = _HEADER.size
    (step,) = _STEP.unpack(slice_of(data, at, _STEP.size))
    at += _STEP.size
    count, at = byte_at(data, at), at + 1
    if not 1 <= count <= 2:
        raise ValueError(f"{count} other columns; there are 1 or 2")
    sizes, at = slice_of(data, at, count), at + count
    names = []
    for size in sizes:
        names.append(slice_of(data, at, size).decode("utf-8", "replace"))
        at += size
    return step, tuple(names), at


def _counted(values: Floats, step: float) -> Integers:
    """Return the number of steps of each value; 0 where that is none."""
    with np.errstate(all="ignore"):
        k = np.rint(values / step)
        return np.where(np.abs(k) <= _MOST_STEPS, k, 0.0).astype(np.int64)


def _on_grid(k: Integers, step: float, form: int) -> Floats:
    with np.errstate(all="ignore"):
        values = k.astype(np.float64) * step
        return values.astype(np.float32).astype(np.float64) if form == _SINGLE_STEPS else values


def _bits(values: Floats) -> Integers:
    return np.ascontiguousarray(values).view(np.int64)


def _differences(values: Integers) -> Integers:
    """Return the first value and the differences; they wrap around."""
    return np.diff(values, prepend=np.int64(0))
