"""Sequential reader of a peer's bytes within a budget (Part 6, 5.2).

A length is checked against the remaining bytes and the budget before memory is allocated. Fields of
a fixed size may be read beyond the end of a body inside a message; :meth:`Reader.leave` detects
this.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from asyncua import ua

_Codes = ua.StatusCodes
_LENGTH = struct.Struct("<i").unpack_from

Decoder = Callable[["Reader"], Any]


@dataclass(frozen=True)
class Budget:
    """Limits of one message.

    Attributes
    ----------
    elements
        Total number of array elements that are decoded one by one.
    array_length
        Longest array; total number of matrix rows.
    string_bytes
        Longest string.
    nesting
        Deepest nesting of variants, extension objects and structures that contain themselves.
    """

    elements: int
    array_length: int
    string_bytes: int
    nesting: int


class TooMuch(ua.uaerrors.UaStatusCodeError):
    """A message exceeds the budget."""

    def __init__(self) -> None:
        super().__init__(_Codes.BadEncodingLimitsExceeded)


class Malformed(ua.uaerrors.UaStatusCodeError):
    """A message is malformed."""

    def __init__(self) -> None:
        super().__init__(_Codes.BadDecodingError)


class Reader:
    r"""A position in the bytes of a peer, with the remaining budget.

    Attributes
    ----------
    data
        The bytes.
    at, end
        Offset of the next value, and of the end of the current body.

    Examples
    --------
    >>> reader = Reader(b"\2\0\0\0hi", Budget(100, 100, 100, 8))
    >>> reader.byte_string()
    b'hi'
    """

    __slots__ = (
        "_array_length",
        "_elements",
        "_nesting",
        "_rows",
        "_string_bytes",
        "at",
        "data",
        "end",
    )

    def __init__(self, data: bytes, budget: Budget) -> None:
        self.data = data
        self.at = 0
        self.end = len(data)
        self._elements = budget.elements
        self._array_length = self._rows = budget.array_length
        self._string_bytes = budget.string_bytes
        self._nesting = budget.nesting

    @property
    def left(self) -> int:
        """Number of remaining bytes."""
        return self.end - self.at

    def length(self, least: int) -> int:
        """Read the length of an array whose elements take ``least`` bytes or more; -1 is null.

        Raises
        ------
        Malformed, TooMuch
        """
        at = self.at
        (length,) = _LENGTH(self.data, at)
        self.at = at = at + 4
        if length < -1 or length * least > self.end - at:
            raise Malformed
        if length > self._array_length:
            raise TooMuch
        return int(length)

    def byte_string(self) -> bytes | None:
        """Read a ByteString.

        Raises
        ------
        Malformed, TooMuch
        """
        at = self.at
        (length,) = _LENGTH(self.data, at)
        at += 4
        if length < 0:
            if length != -1:
                raise Malformed
            self.at = at
            return None
        stop = at + length
        if stop > self.end:
            raise Malformed
        if length > self._string_bytes:
            raise TooMuch
        self.at = stop
        return self.data[at:stop]

    def spend(self, elements: int) -> None:
        """Subtract elements from the budget.

        Raises
        ------
        TooMuch
        """
        self._elements -= elements
        if self._elements < 0:
            raise TooMuch

    def spend_rows(self, rows: int) -> None:
        """Subtract matrix rows from the budget; a matrix without elements may have many.

        Raises
        ------
        TooMuch
        """
        self._rows -= rows
        if self._rows < 0:
            raise TooMuch

    def nest(self) -> None:
        """Enter a nesting level, until :meth:`unnest`.

        Raises
        ------
        TooMuch
        """
        self._nesting -= 1
        if self._nesting < 0:
            raise TooMuch

    def unnest(self) -> None:
        """Leave a nesting level."""
        self._nesting += 1

    def enter(self) -> int:
        """Enter a body with a length prefix; return the end of the enclosing body.

        Raises
        ------
        Malformed
        """
        at = self.at
        (length,) = _LENGTH(self.data, at)
        self.at = at + 4
        stop = self.at + max(length, 0)
        if length < -1 or stop > self.end:
            raise Malformed
        outer, self.end = self.end, stop
        return outer

    def leave(self, outer: int) -> None:
        """Leave a body, skipping its unread bytes.

        Raises
        ------
        Malformed
            if the reader is beyond the end of the body.
        """
        if self.at > self.end:
            raise Malformed
        self.at, self.end = self.end, outer
