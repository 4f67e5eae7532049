"""Notifications of a block in OPC UA binary (Part 6, 5.2.2.17): records of a few layouts."""

from functools import lru_cache

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from service.hardened.address_space.blocks import Block
from service.hardened.binary.encoding import ARRAY, SERVER, SOURCE, STATUS, VALUE
from service.hardened.monitoring.block_queue import Counts, Notifications

_MASKS = 16
_OF_STAMPS = np.zeros(4, np.uint8)
_OF_STAMPS[ua.TimestampsToReturn.Source] = SOURCE
_OF_STAMPS[ua.TimestampsToReturn.Server] = SERVER
_OF_STAMPS[ua.TimestampsToReturn.Both] = SOURCE | SERVER


def encode_records(
    reported: Notifications, handles: NDArray[np.uint32], stamps: NDArray[np.int8], block: Block
) -> tuple[bytes, Counts]:
    """Encode notifications, N of them, each with its client handle and the times it is to show.

    Returns
    -------
    data
        The records, one after the other.
    ends
        Where each ends, after a 0: shape (N + 1,).
    """
    masks = (
        _OF_STAMPS[stamps] | reported.has.view(np.uint8) | (reported.codes != 0) * np.uint8(STATUS)
    )
    first = int(masks[0]) if len(masks) else 0
    uniform = bool((masks == first).all())
    layout = _layout(first if uniform else VALUE | STATUS | SOURCE | SERVER, block)
    records = np.empty(len(reported), layout)
    parts = {
        "handle": handles,
        "mask": masks,
        "type": block.type if block.length is None else block.type | ARRAY,
        "length": block.width,
        "value": reported.values,
        "status": reported.codes,
        "source": reported.source,
        "server": reported.server,
    }
    for name in layout.names or ():
        records[name] = parts[name]
    if uniform:
        return records.tobytes(), np.arange(len(reported) + 1) * layout.itemsize
    there = _bytes_there(block)
    data = records.view(np.uint8).reshape(len(reported), -1)[there[masks]]
    ends = np.zeros(len(reported) + 1, np.int64)
    np.cumsum(there.sum(axis=1)[masks], out=ends[1:])
    return data.tobytes(), ends


def _layout(mask: int, block: Block) -> np.dtype[np.void]:
    return _layout_of(mask, block.dtype.str, None if block.length is None else block.width)


@lru_cache
def _layout_of(mask: int, dtype: str, length: int | None) -> np.dtype[np.void]:
    fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = [
        ("handle", "<u4"),
        ("mask", "u1"),
    ]
    if mask & VALUE:
        fields.append(("type", "u1"))
        if length is not None:
            fields.append(("length", "<i4"))
        fields.append(("value", dtype, (1 if length is None else length,)))
    if mask & STATUS:
        fields.append(("status", "<u4"))
    if mask & SOURCE:
        fields.append(("source", "<i8"))
    if mask & SERVER:
        fields.append(("server", "<i8"))
    return np.dtype(fields)


def _bytes_there(block: Block) -> NDArray[np.bool_]:
    return _bytes_there_of(block.dtype.str, None if block.length is None else block.width)


@lru_cache
def _bytes_there_of(dtype: str, length: int | None) -> NDArray[np.bool_]:
    """Which bytes of the longest layout each mask keeps, shape (masks, bytes)."""
    whole = _layout_of(VALUE | STATUS | SOURCE | SERVER, dtype, length)
    there = np.zeros((_MASKS, whole.itemsize), np.bool_)
    for mask in range(_MASKS):
        fields = whole.fields
        for name in _layout_of(mask, dtype, length).names or ():
            assert fields is not None  # noqa: S101 - it has names
            kind, start = fields[name][:2]
            there[mask, start : start + kind.itemsize] = True
    return there
