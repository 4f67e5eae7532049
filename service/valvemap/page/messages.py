"""Messages to a browser: numbers as binary frames, everything else as JSON. Pure.

All little endian; times are ms since 1970, StatusCodes as in OPC UA::

    kind 1, numbers:  u1 kind, u1 0, u2 valve, u4 n,
                      n × f8 value, n × f8 time, n × u4 code, n × u2 name
    kind 2, matrix:   u1 kind, u1 0, u2 valve, u2 name, u2 0, u4 rows, u4 columns, f8 time,
                      rows × columns × f8
    kind 3, rows:     u1 kind, u1 columns, u2 0, u4 n, n × columns × f8, n × u2 valve
    kind 4, trend:    u1 kind, u1 whether from the service's history, u2 courses, u4 question,
                      f8 start, f8 step, f8 seen since (ms), u4 n, courses × 3 × n × f4

Names are sent as numbers, assigned by an earlier JSON message ``{"names": [...]}``.
"""

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from valvemap.page.trends import Trend

_NUMBERS, _MATRIX, _ROWS, _TREND = 1, 2, 3, 4
_MS = 1e-6  # ms per ns


def pack_numbers(valve: int, entries: Sequence[tuple[int, float, int, int]]) -> bytes:
    """Pack (name, value, code, time in ns) of one valve.

    >>> len(pack_numbers(0, [(3, 1.5, 0, 0)]))
    30
    """
    names, values, codes, times = zip(*entries, strict=True)
    head = np.array([_NUMBERS, 0], "<u1").tobytes() + np.array([valve], "<u2").tobytes()
    return b"".join(
        (
            head,
            np.array([len(entries)], "<u4").tobytes(),
            np.array(values, "<f8").tobytes(),
            (np.array(times, "<f8") * _MS).tobytes(),
            np.array(codes, "<u4").tobytes(),
            np.array(names, "<u2").tobytes(),
        )
    )


def pack_matrix(valve: int, name: int, matrix: Sequence[Any], t: int) -> bytes:
    """Pack a vector or a matrix; None and elements that are not numbers become NaN."""
    values = np.atleast_2d(np.array(matrix, "<f8"))
    return b"".join(
        (
            np.array([_MATRIX, 0], "<u1").tobytes(),
            np.array([valve, name, 0], "<u2").tobytes(),
            np.array(values.shape, "<u4").tobytes(),
            np.array([t * _MS], "<f8").tobytes(),
            values.tobytes(),
        )
    )


def pack_rows(valves: Sequence[int], rows: Sequence[Sequence[float]]) -> bytes:
    """Pack one row of numbers for each of the given valves."""
    values = np.array(rows, "<f8")
    return b"".join(
        (
            np.array([_ROWS, values.shape[1]], "<u1").tobytes(),
            np.array([0], "<u2").tobytes(),
            np.array([len(valves)], "<u4").tobytes(),
            values.tobytes(),
            np.array(valves, "<u2").tobytes(),
        )
    )


def pack_trend(question: int, trend: Trend) -> bytes:
    """Pack the answer to a question for a trend."""
    n = trend.courses[0].shape[1] if trend.courses else 0
    times = np.array([trend.start, trend.step, trend.since], "<f8") * _MS
    return b"".join(
        (
            np.array([_TREND, trend.is_kept], "<u1").tobytes(),
            np.array([len(trend.courses)], "<u2").tobytes(),
            np.array([question], "<u4").tobytes(),
            times.tobytes(),
            np.array([n], "<u4").tobytes(),
            *(np.asarray(course, "<f4").tobytes() for course in trend.courses),
            *(np.asarray(doubt, "<u1").tobytes() for doubt in trend.doubts),
        )
    )


def pack_text(message: Mapping[str, Any]) -> str:
    """Encode as JSON; NaN and infinity become null.

    >>> pack_text({"U": math.nan, "names": ("a",)})
    '{"U":null,"names":["a"]}'
    """
    return json.dumps(_finite(message), ensure_ascii=False, separators=(",", ":"))


def _finite(thing: Any) -> Any:  # noqa: ANN401 - any JSON
    if isinstance(thing, float):
        return thing if math.isfinite(thing) else None
    if isinstance(thing, Mapping):
        return {key: _finite(value) for key, value in thing.items()}
    if isinstance(thing, list | tuple):
        return [_finite(value) for value in thing]
    return thing
