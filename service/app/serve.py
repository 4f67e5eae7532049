"""The live service from start to end."""

import asyncio
from collections.abc import Callable

import structlog

from service.app.build import (
    build_identification,
    build_live_settings,
    build_server_settings,
    build_source,
    build_supervisor_settings,
)
from service.app.warm_up import warm_up
from service.clock import SystemClock
from service.config.models import Config
from service.hardened import ServerSettings
from service.identification.samples import Samples
from service.opcua.decoding import was_compiled_before
from service.opcua.results_server import ResultsServer
from service.storage.checkpoints import CheckpointFile
from service.streaming.identification import Identification
from service.streaming.live import LiveService
from service.streaming.supervisor import supervise

log = structlog.get_logger(__name__)

SampleTap = Callable[[str, Samples], None]


async def serve(
    config: Config,
    stop: asyncio.Event,
    server_settings: ServerSettings | None = None,
    identification: Identification | None = None,
    on_samples: SampleTap | None = None,
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

    Raises
    ------
    ValvemapError
        at start: of the configuration, the source, the server's address, the stores; at the end:
        if the states cannot be kept.
    """
    compiled = asyncio.create_task(asyncio.to_thread(warm_up, config))

    async def ready() -> None:  # no sample waits for a compiler
        await asyncio.shield(compiled)

    clock = SystemClock()
    settings = server_settings or build_server_settings(config)
    identification = identification or build_identification(config)
    source = build_source(config, ready)
    with CheckpointFile(config.state.file) as store:
        if store.set_aside is not None:
            log.warning("damaged or old state file set aside", file=str(store.set_aside))
        server = ResultsServer(
            settings,
            identification.descriptions(),
            identification,
            scalars_interval_s=config.server.results_interval_ms * 1e-3,
        )
        live = LiveService(
            identification, source, server, store, clock, build_live_settings(config), on_samples
        )
        async with server:
            await live.start()
            log.info("results served", url=server.url)
            if not was_compiled_before():
                await asyncio.wait({compiled}, timeout=2.0)
                if not compiled.done():
                    log.info("compiling: half a minute at the first start")
                await compiled
            try:
                await supervise(source, live, clock, stop, build_supervisor_settings(config))
            finally:
                await live.keep()
