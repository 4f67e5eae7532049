"""Waits for a valid new configuration, and makes its plan."""

import asyncio

import structlog

from guarded_opcua import HardenedError
from valvemap.app.plan import Plan, make_plan
from valvemap.app.reload import Reload, check_what_stays, in_one_line
from valvemap.errors import ValvemapError

log = structlog.get_logger(__name__)


async def next_plan(
    plan: Plan, reload: Reload, ended: asyncio.Event, completing: asyncio.Task[None]
) -> Plan:
    """Wait for a valid new configuration, end this one, and transfer the source to the new one.

    A preview is completed first: the states of its waiting estimators could not be transferred.
    """
    await asyncio.shield(completing)
    while True:
        outcome = await reload.requests.get()
        try:
            following = await _checked(plan, reload)
        except (ValvemapError, HardenedError) as error:
            log.warning(
                "configuration refused, the present one stays in use", reason=in_one_line(error)
            )
            if not outcome.done():
                outcome.set_exception(error)
            continue
        if not outcome.done():
            outcome.set_result(None)
        if following is None:
            log.info("configuration unchanged")
            continue
        log.info("configuration taken over", valves=len(following.config.valves))
        following.source.succeed(plan.source)
        following.axis_source.succeed(plan.axis_source)
        ended.set()
        return following


async def _checked(plan: Plan, reload: Reload) -> Plan | None:
    """Load and check the new configuration; return its plan, or None if it is unchanged."""
    config = await asyncio.to_thread(reload.load)
    if config == plan.config:
        return None
    check_what_stays(plan.config, config)
    following = make_plan(config, plan.given_settings, after_another=True)
    await following.compiled.ended()
    await following.source.check()
    await following.axis_source.check()
    return following
