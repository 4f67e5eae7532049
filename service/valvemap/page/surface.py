"""The map as a surface: Q, its uncertainty and status on a grid, read with method calls."""

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

from valvemap.page.ports import Client

POINTS_U, POINTS_DP = 21, 17
_WIDEST_U, _WIDEST_DP = (0.0, 100.0), (0.0, 200.0)  # %, bar, if the service has no limits
_AT_ONCE = 51  # points of one call: three rows; other clients are served between two calls
_NAN = float("nan")


async def draw_surface(
    client: Client, valve: str, estimator: str, *, approved: bool = False
) -> Mapping[str, Any]:
    """Read an estimator's map at the last measured temperature: the present or the approved one.

    Returns
    -------
    dict
        ``U`` (POINTS_U,), ``Dp`` (POINTS_DP,); ``Q``, ``Std`` (l/min) and ``Status`` of shape
        (POINTS_U, POINTS_DP).

    Raises
    ------
    CommandRejected
        if there is no such map.
    SourceLost, SourceRejected
    """
    (axis,) = await client.read([f"{valve}.Inverse.MapDp"])
    dp = _axis(_span(axis.value, _WIDEST_DP), POINTS_DP)
    U = _axis(_WIDEST_U, POINTS_U)
    points = [(u, p, _NAN) for u, p in product(U, dp)]
    answers: list[tuple[Any, ...]] = []
    for start in range(0, len(points), _AT_ONCE):
        chunk = points[start : start + _AT_ONCE]
        if approved:
            inputs = [(estimator, *point) for point in chunk]
            answers += await client.call(f"{valve}.Baseline", "Predict", inputs)
        else:
            answers += await client.call(f"{valve}.{estimator}", "Predict", chunk)
    rows = [answers[k : k + POINTS_DP] for k in range(0, len(answers), POINTS_DP)]
    columns = {
        name: [[float(answer[k]) for answer in row] for row in rows]
        for k, name in enumerate(("Q", "Std", "Status"))
    }
    return {"U": U, "Dp": dp, **columns}


def _span(axis: object, otherwise: tuple[float, float]) -> tuple[float, float]:
    if isinstance(axis, list) and len(axis) > 1 and axis[0] < axis[-1]:
        return axis[0], axis[-1]
    return otherwise


def _axis(span: Sequence[float], n: int) -> list[float]:
    low, high = span
    return [low + (high - low) * k / (n - 1) for k in range(n)]
