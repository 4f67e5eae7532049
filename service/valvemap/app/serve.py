"""Runs the live service."""

import asyncio
from collections.abc import Callable, Coroutine
from contextlib import AsyncExitStack
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import structlog

from guarded_opcua import HardenedError, ServerSettings
from valvemap.app.axes import axes_file, run_axes
from valvemap.app.commissions import Commissions
from valvemap.app.connections import (
    build_history,
    build_live_settings,
    build_server_settings,
    build_supervisor_settings,
    own_certificate,
)
from valvemap.app.history_span import span_in_words
from valvemap.app.limits import allow_descriptors, descriptors_needed
from valvemap.app.memory import giving_back
from valvemap.app.next_plan import next_plan
from valvemap.app.plan import Plan, make_plan
from valvemap.app.pulse import Pulse
from valvemap.app.reload import Reload, in_one_line
from valvemap.app.service_manager import ServiceManager, feed_watchdog
from valvemap.app.shown import Shown
from valvemap.app.staged_start import complete, first_identification
from valvemap.clock import SystemClock
from valvemap.config.models import Config
from valvemap.daemon_thread import unless_stopped
from valvemap.errors import ValvemapError
from valvemap.model.kernels import interpreted
from valvemap.model.kernels.warmed_up import was_warmed_up
from valvemap.model.samples import Samples
from valvemap.pipeline.identification import Identification
from valvemap.runtime.axes import AxisTap
from valvemap.runtime.dynamics import LiveDynamics
from valvemap.runtime.live import LiveService
from valvemap.runtime.past import PastKeeper
from valvemap.runtime.sources import supervise_all
from valvemap.runtime.transferred_states import TransferredStates, transfer
from valvemap.storage.checkpoints import CheckpointFile
from valvemap.storage.history import HistoryFile

log = structlog.get_logger(__name__)

SampleTap = Callable[[str, Samples], None]


async def serve(
    config: Config,
    stop: asyncio.Event,
    server_settings: ServerSettings | None = None,
    identification: Identification | None = None,
    on_samples: SampleTap | None = None,
    reload: Reload | None = None,
    manager: ServiceManager | None = None,
    on_axis_samples: AxisTap | None = None,
) -> None:
    """Identify and publish until ``stop`` is set; store all states at the end.

    Parameters
    ----------
    config
        The whole configuration.
    stop
        Stops the service.
    server_settings
        Replaces the configured server settings (the demo's open endpoint).
    identification
        Replaces the identification built from the configuration, so that a caller can inspect it.
    on_samples
        Called with each valve's samples when they are processed.
    reload
        The queue of reload requests.
    manager
        Notified when clients are served, while the service is alive, and when it stops.

    on_axis_samples
        Called with each axis' samples, before its answers are written.

    Raises
    ------
    ValvemapError
        at start: if the configuration, the source, the server's address or a store cannot be
        used; at the end: if the states cannot be stored.
    """
    reload, manager = reload or Reload(lambda: config), manager or ServiceManager()
    settings = server_settings or build_server_settings(config)
    allow_descriptors(descriptors_needed(settings.limits.connections, len(config.all_sources)))
    identification = identification or first_identification(config)
    plan: Plan | None = make_plan(config, server_settings, identification)
    before: Plan | None = None
    shown = Shown(reload)
    async with AsyncExitStack() as opened:
        opened.callback(interpreted.end)
        file = opened.enter_context(CheckpointFile(config.state.file))
        opened.callback(_name_lost_file, file)
        stores = _Stores(
            TransferredStates(file), cache(lambda: _open_states_of_axes(config, opened))
        )
        past, keeper = build_history(config), None
        if past is not None:
            opened.enter_context(past)
            keeper = PastKeeper(past)
            opened.callback(keeper.end)
            for note in past.take_notes():
                log.warning("history damaged", reason=note, lost=past.lost)
            log.info("history kept", size=span_in_words(config, past.bytes_per_s))
        if file.set_aside is not None:
            log.warning("damaged or old state file set aside", file=str(file.set_aside))
        opened.push_async_callback(shown.end)
        await opened.enter_async_context(giving_back())
        while plan is not None:
            try:
                following = await _live(
                    plan,
                    stores,
                    past,
                    keeper,
                    stop,
                    on_samples,
                    reload,
                    shown,
                    manager,
                    on_axis_samples,
                )
            except (ValvemapError, HardenedError) as error:
                if before is None or stop.is_set():
                    raise
                reason = in_one_line(error)
                log.warning("configuration failed, the previous one is in use again", reason=reason)
                back = make_plan(before.config, server_settings, after_another=True)
                back.source.succeed(plan.source)
                await plan.source.close()
                plan, before = back, None
            else:
                plan, before = following, plan


@dataclass(frozen=True)
class _Stores:
    """The stores of states; that of the axes is opened with the first of them."""

    of_valves: TransferredStates
    of_axes: Callable[[], TransferredStates]


def _open_states_of_axes(config: Config, opened: AsyncExitStack) -> TransferredStates:
    file = opened.enter_context(CheckpointFile(axes_file(config)))
    opened.callback(_name_lost_file, file)
    return TransferredStates(file)


def _name_lost_file(file: CheckpointFile) -> None:
    if file.renewed:
        log.warning("state file was lost while in use", file=str(file.path), times=file.renewed)


async def _live(
    plan: Plan,
    stores: _Stores,
    past: HistoryFile | None,
    keeper: PastKeeper | None,
    stop: asyncio.Event,
    on_samples: SampleTap | None,
    reload: Reload,
    shown: Shown,
    manager: ServiceManager,
    on_axis_samples: AxisTap | None,
) -> Plan | None:
    """Run one configuration to its end; return the next plan, or None to stop."""
    config, clock = plan.config, SystemClock()
    if keeper is not None:
        await keeper.follow([valve.name for valve in config.valves])
    server = await shown.server(plan, past, None if keeper is None else keeper.note_alarm)
    share, window_s = config.dynamics.share, config.dynamics.window_s
    dynamics = LiveDynamics(plan.identification, clock, share, window_s) if share else None
    live = LiveService(
        plan.identification,
        plan.source,
        server,
        stores.of_valves,
        clock,
        build_live_settings(config, own_certificate(config) if plan.settings.pki else None),
        on_samples,
        keeper,
        dynamics,
    )
    commissions = Commissions(config, plan.identification, server, clock)
    await server.commissions.follow(commissions.valves, commissions)
    ended = asyncio.Event()
    await live.start()
    server.show_demands(plan.identification.answers.demands())
    log.info("results served", url=server.url)
    completing = asyncio.create_task(_complete(plan, live, ended))
    waits = plan.identification.journal is None and not was_warmed_up()
    if not waits or await unless_stopped(stop, plan.compiled.ended()):
        manager.ready(f"{len(config.valves)} valves at {server.url}")
    pulse = Pulse(live, clock)
    watched = asyncio.create_task(feed_watchdog(manager, pulse, clock))
    stopping = asyncio.create_task(_pass_on(stop, live, ended, manager))
    following = asyncio.create_task(next_plan(plan, reload, ended, completing))
    try:
        supervision = build_supervisor_settings(config)
        supervision = replace(supervision, connected_before=plan.after_another)
        await _together(
            ended,
            supervise_all(plan.source, pulse, clock, ended, supervision),
            run_axes(
                config,
                server,
                clock,
                ended,
                plan.axis_source,
                supervision,
                stores.of_axes,
                live.note_states_elsewhere,
                on_axis_samples,
                None if keeper is None else keeper.note_axis,
            ),
        )
    finally:
        server.take_no_commands()
        await commissions.end()
        if dynamics is not None:
            await dynamics.end()
        plan.compiled.stop()
        if stop.is_set():
            completing.cancel()
        for task in (watched, stopping, following):
            task.cancel()
        tasks = watched, stopping, following, completing
        await asyncio.gather(*tasks, return_exceptions=True)
        goes_on = not (following.cancelled() or stop.is_set())
        if not goes_on and not await live.keep(within_s=live.time_left_s):
            log.warning("disk too slow to keep the last states, those before are kept")
    if not completing.cancelled():
        await completing  # raises if the kernels could not be compiled
    if not goes_on:
        return None
    await transfer(live.keeper, live.keep, stores.of_valves)
    return following.result()


async def _together(ended: asyncio.Event, *lives: Coroutine[Any, Any, None]) -> None:
    """Run valves and axes until ``ended``; an error of one ends the others, and is raised."""
    tasks = [asyncio.create_task(life) for life in lives]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_EXCEPTION)
    finally:
        ended.set()
        outcomes = await asyncio.gather(*tasks, return_exceptions=True)
    for outcome in outcomes:
        if isinstance(outcome, BaseException):
            raise outcome


async def _complete(plan: Plan, live: LiveService, ended: asyncio.Event) -> None:
    """Compile, and complete a preview; an error ends the service."""
    try:
        if plan.identification.journal is None:
            await plan.compiled.ended()
        else:
            await complete(plan.config, plan.compiled, live)
    except BaseException:
        ended.set()
        raise


async def _pass_on(
    stop: asyncio.Event, live: LiveService, ended: asyncio.Event, manager: ServiceManager
) -> None:
    await stop.wait()
    manager.stopping()
    live.end_soon()
    ended.set()
