"""Integers as planes of bytes: one byte if constant, deflated if that saves space, else plain."""

import struct
import zlib
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

_CONSTANT, _PLAIN, _DEFLATED = range(3)
_PLANES: Final = 8
_BITS: Final = 8  # of a byte
_ZEROS: Final = bytes([_CONSTANT, 0])  # a plane
_MOST_BITS: Final = 7.7  # of a byte; a plane with more information is not deflated
Integers = NDArray[np.int64]


def packed_integers(values: Integers) -> bytes:
    """Return integers (n,) as planes of bytes, those near zero with leading zeros."""
    folded = ((values << 1) ^ (values >> 63)).view(np.uint64).astype("<u8", copy=False)
    used = -(-int(folded.max(initial=0)).bit_length() // _BITS)  # planes that are not all zero
    planes = np.ascontiguousarray(folded.view(np.uint8).reshape(len(values), _PLANES).T[:used])
    return b"".join([_plane(plane) for plane in planes]) + _ZEROS * (_PLANES - used)


def _plane(plane: NDArray[np.uint8]) -> bytes:
    if (plane == plane[0]).all():
        return bytes([_CONSTANT, int(plane[0])])
    data = plane.tobytes()
    share = np.bincount(plane) / len(plane)
    share = share[share > 0]
    if -(share * np.log2(share)).sum() < _MOST_BITS:
        deflated = zlib.compress(data, 1)
        if len(deflated) < len(data):
            return struct.pack("<BI", _DEFLATED, len(deflated)) + deflated
    return bytes([_PLAIN]) + data


def unpacked_integers(data: bytes, at: int, n: int) -> tuple[Integers, int]:
    """Return n integers from the planes at a place, and the place behind them."""
    planes = np.zeros((n, _PLANES), np.uint8)
    for place in range(_PLANES):
        kind, at = byte_at(data, at), at + 1
        if kind == _CONSTANT:
            value, at = byte_at(data, at), at + 1
            if value:
                planes[:, place] = value
            continue
        if kind == _PLAIN:
            plane, at = slice_of(data, at, n), at + n
        elif kind == _DEFLATED:
            (length,) = struct.unpack("<I", slice_of(data, at, 4))
            plane, at = _inflated(slice_of(data, at + 4, length), n), at + 4 + length
        else:
            raise ValueError(f"no plane of kind {kind}")
        if len(plane) != n:
            raise ValueError("a plane is cut short")
        planes[:, place] = np.frombuffer(plane, np.uint8)
    folded: NDArray[Any] = planes.reshape(-1).view("<u8").astype(np.uint64, copy=False)
    values = (folded >> np.uint64(1)).view(np.int64) ^ -(folded & np.uint64(1)).view(np.int64)
    return values, at


def byte_at(data: bytes, at: int) -> int:
    """Return one byte.

    Raises
    ------
    ValueError
        beyond the end.
    """
    return slice_of(data, at, 1)[0]


def slice_of(data: bytes, at: int, size: int) -> bytes:
    """Return ``size`` bytes from ``at``.

    Raises
    ------
    ValueError
        if there are fewer.
    """
    found = data[at : at + size]
    if len(found) != size:
        raise ValueError("cut short")
    return found


def _inflated(data: bytes, n: int) -> bytes:
    inflating = zlib.decompressobj()
    try:
        found = inflating.decompress(data, n + 1)
    except zlib.error as error:
        raise ValueError(str(error)) from error
    if not inflating.eof:
        raise ValueError("cut short, or longer than any block")
    return found
