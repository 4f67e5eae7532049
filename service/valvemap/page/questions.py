"""Questions of a browser, answered by the service: voltages, trends, alarms, comparisons."""

from collections.abc import Sequence
from typing import Any, TypeVar

from valvemap.errors import CommandRejected, ValvemapError
from valvemap.page.alarm_list import MOST_PAST, row_of
from valvemap.page.layout import Part, Valve
from valvemap.page.messages import pack_text, pack_trend
from valvemap.page.observer import Observer
from valvemap.page.tracking import tracking_of
from valvemap.page.trends import MOST_INTERVALS, MOST_NAMES, STEPS_MS, recorded

_MS = 1_000_000  # ns
_LATEST_MS = 4_102_444_800_000  # the year 2100
_LONGEST_MS = 400 * 86_400_000
_NAN = float("nan")
Place = TypeVar("Place", Valve, Part, Valve | Part)
_PRESSURES_AND_T = 5  # further inputs of an axis' Invert


class Senseless(Exception):  # noqa: N818 - it says what came
    """A viewer sent an invalid request."""


async def answer_to(observer: Observer, number: int, question: dict[str, Any]) -> str | bytes:
    """Return the packed answer to question ``number``; nothing is written.

    Raises
    ------
    Senseless
    """
    if not 0 <= number < 2**32:
        raise Senseless
    try:
        match question:
            case {"invert": str() as name, "Q": float() | int() as Q, "dp": float() | int() as dp}:
                answer = await _invert(observer, _place(observer.valves, name), float(Q), float(dp))
            case {"invert": str() as name, "v": float() | int() as v}:
                if name not in {axis.name for axis in observer.parts}:
                    raise Senseless
                answer = await _invert_speed(observer, name, float(v))
            case {
                "trend": str() as name,
                "names": list() as names,
                "from": int() as start,
                "to": int() as end,
                "step": int() as step,
            }:
                valve = _place(observer.places, name)
                _check_trend(names, valve, start, end, step)
                span = start * _MS, end * _MS
                return pack_trend(
                    number, await observer.trends.read(valve, names, span, step * _MS)
                )
            case {"past": True, "from": int() as start, "to": int() as end}:
                _check_span(start, end)
                answer = await _past(observer, start, end)
            case {"tracking": True}:
                answer = await tracking_of(observer.client, observer.parts)
            case {"compare": str() as name, "estimator": str() as estimator}:
                answer = await _compare(observer, _place(observer.valves, name), estimator)
            case _:
                raise Senseless
    except ValvemapError as error:
        answer = {"error": str(error)}
    return pack_text({"answer": number, **answer})


async def _invert(observer: Observer, valve: Valve, Q: float, dp: float) -> dict[str, Any]:
    """Ask for the voltage of a flow."""
    ((U, lower, upper, status),) = await observer.client.call(
        f"{valve.name}.Inverse", "Invert", [(Q, dp, _NAN)]
    )
    return {"Q": Q, "dp": dp, "U": U, "lower": lower, "upper": upper, "status": status}


async def _invert_speed(observer: Observer, axis: str, v: float) -> dict[str, Any]:
    """Ask for the voltage of a speed at the newest pressures of an axis."""
    ((U, lower, upper, status),) = await observer.client.call(
        f"{axis}.Inverse", "Invert", [(v, *[_NAN] * _PRESSURES_AND_T)]
    )
    return {"v": v, "U": U, "lower": lower, "upper": upper, "status": status}


async def _past(observer: Observer, start: int, end: int) -> dict[str, Any]:
    """Return past changes of alarms, the newest first; whether the service keeps them."""
    try:
        found = await observer.trends.past_conditions((start * _MS, end * _MS), MOST_PAST)
    except CommandRejected as error:
        return {"past": [], "kept": False, "why": str(error)}
    return {"past": [row_of(change) for change in found], "kept": True}


async def _compare(observer: Observer, valve: Valve, estimator: str) -> dict[str, Any]:
    """Return how the present map differs from the approved one."""
    if estimator not in valve.estimators:
        raise Senseless
    ((mean, largest, U, dp, points),) = await observer.client.call(
        f"{valve.name}.Baseline", "Compare", [[estimator]]
    )
    return {"mean": mean, "largest": largest, "U": U, "dp": dp, "points": points}


def _place(places: Sequence[Place], name: str) -> Place:
    for place in places:
        if place.name == name:
            return place
    raise Senseless


def _check_trend(
    names: Sequence[Any], valve: Valve | Part, start: int, end: int, step: int
) -> None:
    _check_span(start, end)
    known = frozenset(recorded(valve))
    are_known = all(isinstance(name, str) and name in known for name in names)
    is_bounded = step in STEPS_MS and end - start <= step * MOST_INTERVALS
    if not (are_known and is_bounded and 0 < len(names) <= MOST_NAMES):
        raise Senseless


def _check_span(start: int, end: int) -> None:
    if not (0 < start < end <= _LATEST_MS and end - start <= _LONGEST_MS):
        raise Senseless
