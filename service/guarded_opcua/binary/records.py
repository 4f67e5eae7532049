"""Vectorised encoder of DataValues (Part 6, 5.2.2.17) as records of a few layouts."""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from guarded_opcua.binary.encoding import ARRAY, SERVER, SOURCE, STATUS, VALUE

_MASKS = 16
_OF_STAMPS = np.zeros(4, np.uint8)
_OF_STAMPS[ua.TimestampsToReturn.Source] = SOURCE
_OF_STAMPS[ua.TimestampsToReturn.Server] = SERVER
_OF_STAMPS[ua.TimestampsToReturn.Both] = SOURCE | SERVER


class Form(NamedTuple):
    """Common format of the records.

    ``type`` and ``dtype`` of the values; ``length`` of each, None for scalars; ``handle``: whether
    a client handle precedes each.
    """

    type: ua.VariantType
    dtype: str
    length: int | None
    handle: bool


def encode_records(
    form: Form, stamps: NDArray[np.int8] | int, parts: Mapping[str, NDArray[Any]]
) -> tuple[bytes, NDArray[np.int64]]:
    """Encode N values with the requested timestamps.

    Parameters
    ----------
    form
        Format of all records.
    stamps
        TimestampsToReturn, for all or for each.
    parts
        Arrays (N,): ``value`` (N, length; 1 for scalars), ``status``, ``has`` (False without a
        value), ``source`` and ``server`` (100 ns since 1601), ``handle``.

    Returns
    -------
    data
        The concatenated records.
    ends
        End offsets of the records, preceded by 0: shape (N + 1,).
    """
    status, count = parts["status"], len(parts["status"])
    masks = _OF_STAMPS[stamps] | parts["has"].view(np.uint8) | (status != 0) * np.uint8(STATUS)
    first = int(masks[0]) if count else 0
    uniform = bool((masks == first).all())
    layout = _layout(first if uniform else VALUE | STATUS | SOURCE | SERVER, form)
    records = np.empty(count, layout)
    constant = {
        "mask": masks,
        "type": form.type if form.length is None else form.type | ARRAY,
        "length": form.length or 1,
    }
    for name in layout.names or ():
        records[name] = constant[name] if name in constant else parts[name]
    if uniform:
        return records.tobytes(), np.arange(count + 1) * layout.itemsize
    there = _bytes_there(form)
    data = records.view(np.uint8).reshape(count, -1)[there[masks]]
    ends = np.zeros(count + 1, np.int64)
    np.cumsum(there.sum(axis=1)[masks], out=ends[1:])
    return data.tobytes(), ends


@lru_cache
def _layout(mask: int, form: Form) -> np.dtype[np.void]:
    fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
    if form.handle:
        fields.append(("handle", "<u4"))
    fields.append(("mask", "u1"))
    if mask & VALUE:
        fields.append(("type", "u1"))
        if form.length is not None:
            fields.append(("length", "<i4"))
        fields.append(("value", form.dtype, (1 if form.length is None else form.length,)))
    if mask & STATUS:
        fields.append(("status", "<u4"))
    if mask & SOURCE:
        fields.append(("source", "<i8"))
    if mask & SERVER:
        fields.append(("server", "<i8"))
    return np.dtype(fields)


@lru_cache
def _bytes_there(form: Form) -> NDArray[np.bool_]:
    """Return the bytes of the longest layout that each mask includes, shape (masks, bytes)."""
    whole = _layout(VALUE | STATUS | SOURCE | SERVER, form)
    there = np.zeros((_MASKS, whole.itemsize), np.bool_)
    for mask in range(_MASKS):
        fields = whole.fields
        for name in _layout(mask, form).names or ():
            assert fields is not None  # noqa: S101 - it has names
            kind, start = fields[name][:2]
            there[mask, start : start + kind.itemsize] = True
    return there
