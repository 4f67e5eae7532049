"""Strict JSON of messages: every value is checked for its type and size."""

import json
import math
from typing import Any, Final

from valvemap.errors import BlockError

MOST_BYTES: Final = 65_536  # bytes of a command or a reply: both texts with all characters escaped
MOST_NAME: Final = 1_024  # characters of an id or a name: the limit of a NodeId
MOST_TEXT: Final = 4_096  # characters of a comment or a reason
LATEST: Final = 2**62  # UTC ns, the year 2116: twice a time fits into 64 bits
LARGEST: Final = 2**63 - 1  # of an integer: it is stored in 64 bits


def loads(message: str | bytes) -> Any:  # noqa: ANN401 - JSON
    """Parse JSON; NaN and Infinity are invalid.

    Raises
    ------
    BlockError
        if it is invalid, or nested too deeply.
    """
    try:
        return json.loads(message, parse_constant=_no_constant)
    except (ValueError, RecursionError):
        raise BlockError("not JSON") from None


def text(name: str, value: object, most: int = MOST_NAME) -> str:
    """Check a string that can be encoded in messages.

    Raises
    ------
    BlockError
    """
    if not isinstance(value, str):
        raise BlockError(f"{name} cannot be so: a text is needed")
    if len(value) > most:
        raise BlockError(f"{name} has {len(value)} characters: at most {most} are allowed")
    try:
        value.encode()
    except UnicodeEncodeError:
        raise BlockError(f"{name} is no valid Unicode") from None
    return value


def whole(name: str, value: object, least: int = 0, most: int = LARGEST) -> int:
    """Check an integer within bounds.

    Raises
    ------
    BlockError
    """
    if type(value) is not int:
        raise BlockError(f"{name}: a whole number is needed")
    if not least <= value <= most:
        raise BlockError(f"{name}: {least} to {most} is allowed")
    return value


def numbers(values: object, most: int) -> tuple[float | None, ...]:
    """Check a list of finite numbers or None.

    Raises
    ------
    BlockError
    """
    if not isinstance(values, list) or not all(_is_number(value) for value in values):
        raise BlockError("values must be numbers, or null")
    if len(values) > most:
        raise BlockError(f"{len(values)} values: at most {most} are allowed")
    return tuple(values)


def _is_number(value: object) -> bool:
    if value is None:
        return True
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer beyond the range of float
        return False


def _no_constant(name: str) -> None:
    raise ValueError(name)
