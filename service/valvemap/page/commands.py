"""Commands of a logged-in user: demands, alarms, maps, guided runs; in a demo, the rig."""

import math
from typing import Any

from valvemap.errors import CommandRejected
from valvemap.page.log_ins import LogIn

_LONGEST_NAME = 100
_LONGEST_COMMENT = 200
_LONGEST_EVENT = 128  # hexadecimal digits of an EventId


async def carry_out(log_in: LogIn, command: dict[str, Any]) -> None:
    """Carry out one command with the user's own rights.

    Raises
    ------
    CommandRejected
        if the command is unknown, or the server refuses it.
    SourceLost, SourceRejected
    """
    match command:
        case {"demand": str() as valve, "Q": float() | int() as Q, "dp": float() | int() as dp}:
            name = _checked(valve)
            await log_in.service.write(f"{name}.Inverse.PressureDrop", _finite(dp))
            await log_in.service.write(f"{name}.Inverse.FlowDemand", _finite(Q))
        case {"demand": str() as axis, "v": float() | int() | None as v}:
            speed = math.nan if v is None else _finite(v)
            await log_in.service.write(f"{_checked(axis)}.Inverse.SpeedDemand", speed)
        case {
            "alarm": str() as alarm,
            "of": str() as owner,
            "do": "Acknowledge" | "Confirm" as step,
            "comment": str() as text,
        }:
            place = f"{_checked(owner)}.Alarms.{_checked(alarm)}"
            await log_in.service.call(place, step, [[_short(text)]])
        case {
            "alarm": str() as alarm,
            "of": str() as owner,
            "do": "Comment",
            "comment": str() as text,
            "event": str() as event,
        }:
            place = f"{_checked(owner)}.Alarms.{_checked(alarm)}.Condition"
            await log_in.service.comment(place, _event(event), _short(text))
        case {"baseline": str() as valve, "do": "Approve" | "RollBack" as step}:
            await log_in.service.call(f"{_checked(valve)}.Baseline", step, [[]])
        case {"run": str() as valve}:
            await _guide(log_in, f"{_checked(valve)}.Commission", command)
        case {"scenario": str() as scenario}:
            if scenario:
                await _rig(log_in).call("Rig", "StartScenario", [[_checked(scenario)]])
            else:
                await _rig(log_in).call("Rig", "StopScenario", [[]])
        case {
            "fault": str() as kind,
            "valve": str() as valve,
            "size": float() | int() as size,
            "duration": float() | int() as duration,
        }:
            inputs = [[_checked(kind), _finite(size), _finite(duration)]]
            await _rig(log_in).call(_checked(valve), "InjectFault", inputs)
        case _:
            raise CommandRejected("no such command")


async def _guide(log_in: LogIn, run: str, command: dict[str, Any]) -> None:
    """Start or resume a guided run, keep it alive, or abort it."""
    match command:
        case {"do": "Start" | "Resume" as step, "accuracy": float() | int() as accuracy}:
            await log_in.service.call(run, step, [[_finite(accuracy)]])
        case {"do": "Heartbeat", "count": float() | int() as count}:
            await log_in.service.write(f"{run}.Heartbeat", _finite(count))
        case {"do": "Abort"}:
            await log_in.service.call(run, "Abort", [[]])
        case _:
            raise CommandRejected("no such command")


def _rig(log_in: LogIn) -> Any:  # noqa: ANN401 - a client
    if log_in.rig is None:
        raise CommandRejected("there is no virtual rig here")
    return log_in.rig


def _checked(name: str) -> str:
    if not name or len(name) > _LONGEST_NAME or not name.isprintable():
        raise CommandRejected("no such name")
    return name


def _finite(number: float) -> float:
    if not math.isfinite(number):
        raise CommandRejected("a number is needed")
    return float(number)


def _short(text: str) -> str:
    if len(text) > _LONGEST_COMMENT or (text and not text.isprintable()):
        raise CommandRejected(f"a comment has at most {_LONGEST_COMMENT} characters, in one line")
    return text


def _event(digits: str) -> bytes:
    try:
        return bytes.fromhex(digits[:_LONGEST_EVENT])
    except ValueError:
        raise CommandRejected("no such event") from None
