"""The settings of a commissioning, from a valve's configuration, and their meaning in words."""

import math
import os
from typing import Any, Final

from valvemap.config.models import Config
from valvemap.config.valves import ValveConfig
from valvemap.errors import ConfigurationError
from valvemap.pipeline.commission_plan import GOLDEN
from valvemap.pipeline.commission_state import Settings

PUBLISHED_MS: Final = 40.0  # longest publishing interval: samples must be younger than max_age_s


def settings_of(valve: ValveConfig, accuracy: float = 0.0) -> Settings:
    """Return the run's settings from a valve's configuration; ``accuracy`` in l/min, 0: none.

    Raises
    ------
    ConfigurationError
        if the valve has no node to write to, or no heartbeat.
    """
    for node in ("required_U", "heartbeat"):
        if valve.nodes.of(node) is None:
            raise ConfigurationError(
                f"valve {valve.name}: nodes.{node} is needed: commission writes U there, and the "
                "source takes the valve back when the heartbeat stops"
            )
    given = valve.commission
    nominal = max(map(abs, valve.Q_range_l_min)) / math.sqrt(max(map(abs, valve.dp_range_bar)))
    return Settings(
        limits=given.limits(valve.U_range_percent),
        plan=given.plan(),
        accuracy=accuracy,
        opening=0.25 * nominal,
        max_age_s=given.max_age_s,
        operator_s=given.operator_s,
        operator_late_s=given.operator_late_s,
        outage_s=given.outage_s,
        follow_s=given.follow_s,
        follow_percent=given.follow_percent,
    )


def plan_in_words(valve: ValveConfig, settings: Settings) -> list[str]:
    """Return what a run would do, line by line."""
    limits, plan = settings.limits, settings.plan
    pace = plan.pace(limits)
    within = settings.max_age_s + limits.safe_within_s
    period_s = plan.paced_period(limits)
    slows = ", as the slew permits" if period_s > plan.period_s else ""
    low, high = limits.U_range
    course = f"{low:g} … {high:g} % and back every {period_s:.3g} s"
    above = f"above {limits.p_most:g} bar, " if math.isfinite(limits.p_most) else ""
    ends = f" or ± {1.96 * settings.accuracy:.2g} l/min" if settings.accuracy else ""
    return [
        f"valve      {valve.name}: U is written to {valve.nodes.required_U}",
        f"heartbeat  {valve.nodes.heartbeat}: the source takes the valve back when it stops",
        f"checks     {settings.check_s:g} s of good samples; U still; feed-forward disarmed",
        f"sweep      {plan.sweep_s:g} s: U {course}{slows}"
        + (f", at last in {plan.last()[1]:g} s" if plan.last_period_s else ""),
        _load_in_words(valve, settings),
        f"refinement until {plan.most_s:g} s{ends}: moves of {pace.U:.3g} %/s to uncertain points"
        if plan.most_s > plan.sweep_s
        else "refinement none: most_s is sweep_s",
        f"limits     U {low:g} … {high:g} %, {limits.slew_percent_per_s:g} %/s",
        f"retreat    p1 {_range(limits.p1_range)}, p2 {_range(limits.p2_range)} bar",
        f"retreat    Q {_range(limits.Q_range)} l/min",
        f"end        {above}on Ctrl-C or Enter, without the terminal",
        f"safe U     {limits.safe_U:g} % within {within:.3g} s, then handed back to the source",
    ]


def quick(config: Config) -> Config:
    """Return the configuration with publishing intervals that suit the age of samples."""
    interval = min(config.source.publishing_interval_ms, PUBLISHED_MS)
    source = config.source.model_copy(
        update={"publishing_interval_ms": interval, "history_s": 0.0, "warm_start_s": 0.0}
    )
    return config.model_copy(update={"source": source})


def for_audit(settings: Settings) -> dict[str, Any]:
    """Return the settings as the audit record has them."""
    limits, plan = settings.limits, settings.plan
    return {
        "U_range_percent": list(limits.U_range),
        "slew_percent_per_s": limits.slew_percent_per_s,
        "safe_percent": limits.safe_U,
        "load_range_bar": limits.load_range and list(limits.load_range),
        "load_slew_bar_per_s": limits.load_slew_bar_per_s,
        "safe_load_bar": limits.safe_load,
        "sweep_s": plan.sweep_s,
        "most_s": plan.most_s,
        "accuracy_l_min": settings.accuracy,
        "process": os.getpid(),
    }


def _load_in_words(valve: ValveConfig, settings: Settings) -> str:
    limits = settings.limits
    if limits.load_range is None:
        return "load       is not written: the map covers the Δp that the plant shows in the run"
    low, high = limits.load_range
    return (
        f"load       {valve.nodes.load}: {low:g} … {high:g} bar and back every "
        f"{settings.plan.paced_period(limits) / GOLDEN:.3g} s, {limits.load_slew_bar_per_s:g} "
        f"bar/s; safe {limits.safe_load:g} bar"
    )


def _range(bounds: tuple[float, float]) -> str:
    return (
        "any"
        if math.isinf(bounds[0]) and math.isinf(bounds[1])
        else f"{bounds[0]:g} … {bounds[1]:g}"
    )
