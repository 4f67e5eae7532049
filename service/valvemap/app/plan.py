"""The objects that run under one configuration."""

import asyncio
from dataclasses import dataclass
from functools import partial

import structlog

from guarded_opcua import ServerSettings
from valvemap.app.build import build_identification
from valvemap.app.connections import build_server_settings, build_sources
from valvemap.app.warm_up import warm_up
from valvemap.config.models import Config
from valvemap.pipeline.identification import Identification
from valvemap.runtime.daemon_thread import in_daemon_thread
from valvemap.runtime.sources import Sources

log = structlog.get_logger(__name__)


class Compilation:
    """Compiles the kernels of a configuration, or loads them from the cache, in a thread."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._work: asyncio.Future[None] | None = None

    def begin(self) -> "asyncio.Future[None]":
        """Start the compilation unless it was started; return its future."""
        if self._work is None:
            self._work = in_daemon_thread(partial(warm_up, self._config, _show_progress))
        return self._work

    async def ended(self) -> None:
        """Start the compilation if necessary, and wait until it is complete."""
        await asyncio.shield(self.begin())


@dataclass(frozen=True)
class Plan:
    """The objects that run under one configuration."""

    config: Config
    settings: ServerSettings
    identification: Identification
    source: Sources
    compiled: Compilation
    given_settings: ServerSettings | None
    after_another: bool


def make_plan(
    config: Config,
    server_settings: ServerSettings | None = None,
    identification: Identification | None = None,
    *,
    after_another: bool = False,
) -> Plan:
    """Return the plan of a configuration."""
    settings = server_settings or build_server_settings(config)
    identification = identification or build_identification(config)
    compiled = Compilation(config)
    source = build_sources(config, compiled.ended)  # until then samples wait at the source
    return Plan(config, settings, identification, source, compiled, server_settings, after_another)


def _show_progress(done: int, of: int) -> None:
    log.info("compiling, at the first start only", part=done + 1, of=of)
