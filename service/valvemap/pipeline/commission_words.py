"""What an operator reads of a commissioning run. Pure."""

import math
from collections.abc import Iterator

from valvemap.pipeline.commission_limits import Limits
from valvemap.pipeline.commission_state import CommissionState, Reason, Seen, Settings


def in_words(settings: Settings, state: CommissionState, seen: Seen) -> str:
    """Return the progress as a line for the operator."""
    left = max(settings.plan.most_s - state.elapsed, 0.0)
    parts = [state.phase.sentence]
    if state.why:
        parts.append(state.why)
    if not state.phase.is_over:
        parts.append(f"{state.elapsed:.0f} s, at most {left:.0f} s left")
    if not math.isnan(seen.error):
        wanted = f" (wanted {settings.accuracy:.2g} l/min)" if settings.accuracy else ""
        parts.append(f"map ± {1.96 * seen.error:.2g} l/min{wanted}")
    if state.is_led:
        parts.append(f"U {state.at.U:.1f} %")
        if not math.isnan(state.at.load):
            parts.append(f"load {state.at.load:.0f} bar")
    return "; ".join(parts)


def evidence(limits: Limits, reason: Reason, seen: Seen) -> str:
    """Return the measured values that a reason comes of; empty where there are none.

    >>> evidence(Limits(U_range=(5.0, 80.0)), Reason.U_OUTSIDE, Seen(U=95.0))
    'U 95 %, permitted 5 … 80 %'
    """
    match reason:
        case Reason.U_OUTSIDE:
            return _beside("U", seen.U, "%", limits.U_range)
        case Reason.LIMIT | Reason.LIMIT_BEFORE:
            return "; ".join(_beyond(limits, seen))
        case Reason.P_ORDER:
            return f"p1 {seen.p1:.3g} bar, p2 {seen.p2:.3g} bar at a flow of {seen.Q:.3g} l/min"
        case Reason.PRESSURE:
            name = "p1" if seen.p1 >= seen.p2 else "p2"
            return f"{name} {max(seen.p1, seen.p2):.4g} bar, limit {limits.p_most:g} bar"
    return ""


def _beyond(limits: Limits, seen: Seen) -> Iterator[str]:
    for name, x, unit, bounds in (
        ("p1", seen.p1, "bar", limits.p1_range),
        ("p2", seen.p2, "bar", limits.p2_range),
        ("Q", seen.Q, "l/min", limits.Q_range),
    ):
        if not bounds[0] <= x <= bounds[1]:
            yield _beside(name, x, unit, bounds)


def _beside(name: str, x: float, unit: str, bounds: tuple[float, float]) -> str:
    return f"{name} {x:.4g} {unit}, permitted {bounds[0]:g} … {bounds[1]:g} {unit}"
