"""Records of a DataChangeNotification → arrays (OPC UA Part 4, 7.25.2; Part 6, 5.2).

A record is ClientHandle (u4), DataValue mask (u1), Variant encoding (u1), value, then status (u4),
source time (i8, then picoseconds u2) and server time (i8, then u2), each only if the mask has its
bit. Records differ in size, so one compiled loop walks them, checks every mask and type byte, and
decodes all numeric scalars; all others become NaN, but the places of arrays and structures are kept
(:mod:`valvemap.opcua_source.elements`). Types of no fixed size (e.g. structures) are skipped by
:mod:`valvemap.opcua_source.wire`; the loop then continues with the next record.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from valvemap.model.kernels.compiled import kept
from valvemap.opcua_source.elements import COMPOUND, NO_NUMBER
from valvemap.opcua_source.timestamps import (
    EPOCH_TICKS,
    MAX_TICKS,
    MIN_TICKS,
    MOST_PICOSECONDS,
    ns_from_ticks,
)
from valvemap.opcua_source.wire import (
    EXTENSION_OBJECT,
    FIXED_SIZES,
    NUMERIC_FORMATS,
    DecodeError,
    Reader,
)
from valvemap.pipeline.data_changes import DataChanges

_OVERFLOW_MASK = 0x0C80  # InfoType (bits 10 and 11) and Overflow (bit 7)
_OVERFLOW = 0x0480  # InfoType = DataValue, Overflow
_HANDLE = 4  # bytes of the client handle before a value
_MOST_RECORDS = 600_000  # records with a Double in the largest message
_ELEMENTS_PER_RECORD = 4  # cost of skipping a record, in walked elements
_RESERVED = 0xC0  # bits of a DataValue mask
_NO_NUMBER, _COMPOUND = NO_NUMBER, COMPOUND  # as the compiled loop knows them
_IS_ARRAY = 0x80  # bit of a Variant's encoding byte
_OF_KIND = 0x3F


@dataclass(frozen=True)
class Records:
    """Changes, and the types of their values; ``places`` are those of arrays and structures."""

    changes: DataChanges
    overflows: int
    not_numeric: int
    kind: NDArray[np.uint8]
    places: NDArray[np.int64]


def read_records(reader: Reader, publish_time: int, handle: int = _HANDLE) -> Records:
    """Read a list of records, from its length on; each value is preceded by ``handle`` bytes.

    ``publish_time``, UTC ns, is that of a record without a time.

    Raises
    ------
    DecodeError
        if it is truncated, has reserved bits, or too many records.
    """
    n = reader.count(handle + 1)
    if n > _MOST_RECORDS:
        raise DecodeError(f"{n} changes in one message, at most {_MOST_RECORDS} are read")
    raw = np.frombuffer(reader.data, np.uint8)
    item = np.zeros(n, np.int32)
    bits = np.empty(n, np.uint64)
    kind = np.empty(n, np.uint8)
    status = np.empty(n, np.uint32)
    time = np.empty(n, np.int64)
    columns = (item, bits, kind, status, time)
    row = 0
    while True:
        at = reader.position
        row, position = _scan(raw, at, reader.stop, row, publish_time, handle, *columns)
        reader.position = position
        if row == n:
            break
        reader.spend(_ELEMENTS_PER_RECORD)
        _pass_over(reader, row, publish_time, handle, *columns)
        row += 1
    places = bits[kind == _COMPOUND].astype(np.int64)
    return Records(
        DataChanges(item=item, value=_values(bits, kind), status=status, source_time=time),
        overflows=int(np.count_nonzero(overflown(status))),
        not_numeric=int(np.count_nonzero(kind >= _COMPOUND)),
        kind=kind,
        places=places,
    )


def overflown(status: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Return which changes have the Overflow bit: the server dropped earlier ones."""
    return (status & _OVERFLOW_MASK) == _OVERFLOW


def _pass_over(
    reader: Reader,
    row: int,
    publish_time: int,
    handle: int,
    item: NDArray[np.int32],
    bits: NDArray[np.uint64],
    kind: NDArray[np.uint8],
    status: NDArray[np.uint32],
    time: NDArray[np.int64],
) -> None:
    """Decode status and time of one record of another type; its value becomes NaN."""
    if handle:
        item[row] = np.uint32(reader.u4()).view(np.int32)
    mask = reader.u1()
    if mask & _RESERVED:
        raise DecodeError(f"DataValue mask {mask:#x} has reserved bits")
    bits[row], kind[row] = 0, 0
    if mask & 0x01:
        place = reader.position
        encoding = reader.u1()
        reader.skip_variant_body(encoding)
        kind[row] = 0 if encoding == 0 else _NO_NUMBER
        is_array = encoding & _IS_ARRAY and encoding & _OF_KIND in NUMERIC_FORMATS
        if is_array or encoding & _OF_KIND == EXTENSION_OBJECT:
            bits[row], kind[row] = place, _COMPOUND
    status[row] = reader.u4() if mask & 0x02 else 0
    source = reader.i8() if mask & 0x04 else 0
    source_picoseconds = reader.u2() if mask & 0x10 else 0
    server = reader.i8() if mask & 0x08 else 0
    server_picoseconds = reader.u2() if mask & 0x20 else 0
    if source:
        time[row] = ns_from_ticks(source, source_picoseconds)
    elif server:
        time[row] = ns_from_ticks(server, server_picoseconds)
    else:
        time[row] = publish_time


_SIZES = np.zeros(256, np.int64)  # bytes of a value, by its Variant encoding byte
_ELEMENTS = np.zeros(256, np.int64)  # bytes of an element, for types with an Int32 length
for _kind, _size in FIXED_SIZES.items():
    _SIZES[_kind] = _size
    _ELEMENTS[_kind | 0x80] = _size
_ELEMENTS[[12, 15, 16]] = 1  # String, ByteString, XmlElement
_NUMERIC = np.zeros(256, np.bool_)
_NUMERIC[[0, *NUMERIC_FORMATS]] = True


def _values(bits: NDArray[np.uint64], kind: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Return the values as float64; integers beyond 2**53 are rounded."""
    values = bits.view(np.float64)
    present = np.bincount(kind, minlength=256).nonzero()[0]
    for number in present.tolist():
        if number == 11:
            continue
        rows = kind == number
        chosen = bits[rows]
        match number:
            case 10:
                values[rows] = chosen.astype(np.uint32).view(np.float32)
            case 2 | 4 | 6 | 8:
                values[rows] = chosen.view(np.int64)
            case 1 | 3 | 5 | 7 | 9:
                values[rows] = chosen
            case _:
                values[rows] = np.nan
    return values


@njit(cache=True, inline="always")
def _u4(raw: NDArray[np.uint8], at: int) -> np.uint64:
    return (
        np.uint64(raw[at])
        | np.uint64(raw[at + 1]) << np.uint64(8)
        | np.uint64(raw[at + 2]) << np.uint64(16)
        | np.uint64(raw[at + 3]) << np.uint64(24)
    )


@njit(cache=True, inline="always")
def _i8(raw: NDArray[np.uint8], at: int) -> np.int64:
    return np.int64(_u4(raw, at) | _u4(raw, at + 4) << np.uint64(32))


@kept
@njit(cache=True)
def _scan(  # noqa: C901, PLR0912, PLR0915 - one compiled loop
    raw: NDArray[np.uint8],
    position: int,
    stop: int,
    row: int,
    publish_time: int,
    handle: int,
    item: NDArray[np.int32],
    bits: NDArray[np.uint64],
    kind: NDArray[np.uint8],
    status: NDArray[np.uint32],
    time: NDArray[np.int64],
) -> tuple[int, int]:
    """Decode records until all rows are filled, or one is of an unknown type or truncated.

    Each value is preceded by ``handle`` bytes.

    Returns the next row and the position of its record.
    """
    n = len(item)
    while row < n:
        at = position + handle
        if stop - at < 1:
            break
        mask = raw[at]
        if mask & _RESERVED:
            break
        at += 1
        number = np.uint8(0)
        size = 0
        if mask & 0x01:
            if stop - at < 1:
                break
            number = raw[at]
            at += 1
            size = _SIZES[number]
            if _ELEMENTS[number] > 0:
                if stop - at < 4:
                    break
                size = 4 + max(np.int64(np.int32(_u4(raw, at))), 0) * _ELEMENTS[number]
            elif size == 0 and number != 0:
                break
            if not _NUMERIC[number]:
                number = np.uint8(_COMPOUND if number & _IS_ARRAY else _NO_NUMBER)
        tail = size
        if mask & 0x02:
            tail += 4
        if mask & 0x04:
            tail += 8
        if mask & 0x10:
            tail += 2
        if mask & 0x08:
            tail += 8
        if mask & 0x20:
            tail += 2
        if stop - at < tail:
            break
        if number == _NO_NUMBER:
            bits[row] = np.uint64(0)
        elif number == _COMPOUND:
            bits[row] = np.uint64(at - 1)
        elif size == 8:
            bits[row] = np.uint64(_i8(raw, at))
        elif size == 4:
            value = _u4(raw, at)
            bits[row] = np.uint64(np.int32(value)) if number == 6 else value
        elif size == 2:
            value = np.uint64(raw[at]) | np.uint64(raw[at + 1]) << np.uint64(8)
            bits[row] = np.uint64(np.int16(value)) if number == 4 else value
        elif number == 1:
            bits[row] = np.uint64(raw[at] != 0)
        elif size == 1:
            value = np.uint64(raw[at])
            bits[row] = np.uint64(np.int8(value)) if number == 2 else value
        else:
            bits[row] = np.uint64(0)
        at += size
        if handle > 0:
            item[row] = np.int32(_u4(raw, position))
        kind[row] = number
        if mask & 0x02:
            status[row] = np.uint32(_u4(raw, at))
            at += 4
        else:
            status[row] = np.uint32(0)
        ticks = np.int64(0)
        picoseconds = np.int64(0)
        if mask & 0x04:
            ticks = _i8(raw, at)
            at += 8
        if mask & 0x10:
            if ticks != 0:
                picoseconds = np.int64(raw[at]) | np.int64(raw[at + 1]) << 8
            at += 2
        if mask & 0x08:
            if ticks == 0:
                ticks = _i8(raw, at)
                if mask & 0x20 and ticks != 0:
                    picoseconds = np.int64(raw[at + 8]) | np.int64(raw[at + 9]) << 8
            at += 8
        if mask & 0x20:
            at += 2
        if ticks == 0:
            time[row] = publish_time
        else:
            # as ns_from_ticks, which compiled code cannot call
            ticks = min(max(ticks, np.int64(MIN_TICKS)), np.int64(MAX_TICKS))
            picoseconds = min(picoseconds, np.int64(MOST_PICOSECONDS))
            time[row] = (ticks - EPOCH_TICKS) * 100 + picoseconds // 100
        position = at
        row += 1
    return row, position
