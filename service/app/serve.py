"""The live service from start to end."""

import asyncio
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace

import structlog

from service.app.build import (
    build_history,
    build_identification,
    build_live_settings,
    build_server_settings,
    build_sources,
    build_supervisor_settings,
    own_certificate,
)
from service.app.reload import Reload, check_what_stays, in_one_line
from service.app.warm_up import warm_up
from service.clock import SystemClock
from service.config.models import Config
from service.errors import StorageError, ValvemapError
from service.hardened import HardenedError, ServerSettings
from service.identification.kernels.compiled import was_warmed_up
from service.identification.samples import Samples
from service.opcua.results_server import ResultsServer
from service.storage.checkpoints import CheckpointFile
from service.storage.history import HistoryFile
from service.streaming.identification import Identification
from service.streaming.live import LiveService
from service.streaming.past import PastKeeper
from service.streaming.ports import Checkpoint, ValveDescription
from service.streaming.sources import Sources, supervise_all

log = structlog.get_logger(__name__)

SampleTap = Callable[[str, Samples], None]


async def serve(
    config: Config,
    stop: asyncio.Event,
    server_settings: ServerSettings | None = None,
    identification: Identification | None = None,
    on_samples: SampleTap | None = None,
    reload: Reload | None = None,
) -> None:
    """Identify and publish until ``stop`` is set; keep all states at the end.

    Parameters
    ----------
    config
        The whole configuration.
    stop
        Ends the service.
    server_settings
        Instead of what the configuration says (the demo's open endpoint).
    identification
        Instead of a new one from the configuration, for one who wants to look inside.
    on_samples
        Sees every valve's samples as they are identified from.
    reload
        By which another configuration is asked for.

    Raises
    ------
    ValvemapError
        at start: of the configuration, the source, the server's address, the stores; at the end:
        if the states cannot be kept.
    """
    reload = reload or Reload(lambda: config)
    plan: _Plan | None = _plan(config, server_settings, identification)
    before: _Plan | None = None
    known: list[Checkpoint] = []
    shown: tuple[ValveDescription, ...] | None = None  # until now
    with CheckpointFile(config.state.file) as store, ExitStack() as opened:
        past = build_history(config)
        if past is not None:
            opened.enter_context(past)
        if store.set_aside is not None:
            log.warning("damaged or old state file set aside", file=str(store.set_aside))
        while plan is not None:
            described = plan.identification.descriptions()
            try:
                following, states = await _live(
                    plan, store, past, stop, on_samples, reload, known, shown
                )
            except (ValvemapError, HardenedError) as error:
                if before is None or stop.is_set():
                    raise
                reason = in_one_line(error)
                log.warning("configuration given up, the one before it goes on", reason=reason)
                back = _plan(before.config, server_settings, after_another=True)
                back.source.succeed(plan.source)
                await plan.source.close()
                plan, before = back, None
            else:
                plan, before, known = following, plan, states
            shown = described


class _Compilation:
    """Compiling what a configuration needs, in a thread, once somebody waits for it."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._task: asyncio.Task[None] | None = None

    async def ended(self) -> None:
        """Wait for the end of it."""
        if self._task is None:
            compile_all = asyncio.to_thread(warm_up, self._config, _show_progress)
            self._task = asyncio.create_task(compile_all)
        await asyncio.shield(self._task)


@dataclass(frozen=True)
class _Plan:
    """What runs between two configurations."""

    config: Config
    settings: ServerSettings
    identification: Identification
    source: Sources
    compiled: "_Compilation"
    given_settings: ServerSettings | None
    after_another: bool


def _plan(
    config: Config,
    server_settings: ServerSettings | None = None,
    identification: Identification | None = None,
    *,
    after_another: bool = False,
) -> _Plan:
    """Make all that a configuration asks for."""
    settings = server_settings or build_server_settings(config)
    identification = identification or build_identification(config)
    compiled = _Compilation(config)
    source = build_sources(config, compiled.ended)  # no sample waits for a compiler
    return _Plan(config, settings, identification, source, compiled, server_settings, after_another)


async def _live(
    plan: _Plan,
    store: CheckpointFile,
    past: HistoryFile | None,
    stop: asyncio.Event,
    on_samples: SampleTap | None,
    reload: Reload,
    known: list[Checkpoint],
    shown: Sequence[ValveDescription] | None,
) -> tuple[_Plan | None, list[Checkpoint]]:
    """Run one configuration until the end; return what is to run then, and all that is known."""
    config, clock = plan.config, SystemClock()
    keeper = None if past is None else PastKeeper(past, [valve.name for valve in config.valves])
    server = ResultsServer(
        plan.settings,
        plan.identification.descriptions(),
        plan.identification,
        scalars_interval_s=config.server.results_interval_ms * 1e-3,
        on_reload=reload.call,
        past=past,
        on_alarm=None if keeper is None else keeper.note_alarm,
        before=shown,
    )
    live = LiveService(
        plan.identification,
        plan.source,
        server,
        store,
        clock,
        build_live_settings(config, own_certificate(config) if plan.settings.pki else None),
        on_samples,
        keeper,
    )
    ended = asyncio.Event()
    async with server:
        await live.start(known)
        log.info("results served", url=server.url)
        if not was_warmed_up():
            await plan.compiled.ended()
        stopping = asyncio.create_task(_pass_on(stop, live, ended))
        following = asyncio.create_task(_following(plan, reload, ended))
        try:
            supervision = build_supervisor_settings(config)
            supervision = replace(supervision, connected_before=plan.after_another)
            await supervise_all(plan.source, live, clock, ended, supervision)
        finally:
            for task in (stopping, following):
                task.cancel()
            await asyncio.gather(stopping, following, return_exceptions=True)
            goes_on = not (following.cancelled() or stop.is_set())
            if not goes_on and not await live.keep(within_s=live.time_left_s):
                log.warning("disk too slow to keep the last states, those before are kept")
        if not goes_on:
            return None, []
        states = live.states()
        try:
            await live.keep()
        except StorageError as error:
            log.warning("checkpoint not kept", reason=str(error))
    return following.result(), states


async def _pass_on(stop: asyncio.Event, live: LiveService, ended: asyncio.Event) -> None:
    await stop.wait()
    live.end_soon()
    ended.set()


async def _following(plan: _Plan, reload: Reload, ended: asyncio.Event) -> _Plan:
    """Wait for another configuration that holds, and end this one; the source is handed over."""
    while True:
        outcome = await reload.asked()
        try:
            following = await _checked(plan, reload)
        except (ValvemapError, HardenedError) as error:
            log.warning("configuration refused, the old one goes on", reason=in_one_line(error))
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
        ended.set()
        return following


async def _checked(plan: _Plan, reload: Reload) -> _Plan | None:
    """Read the configuration and try what can be tried; None if it is the one that runs."""
    config = await asyncio.to_thread(reload.load)
    if config == plan.config:
        return None
    check_what_stays(plan.config, config)
    following = _plan(config, plan.given_settings, after_another=True)
    await following.compiled.ended()
    await following.source.check()
    return following


def _show_progress(done: int, of: int) -> None:
    log.info("compiling, at the first start only", part=done + 1, of=of)
