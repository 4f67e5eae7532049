"""What runs between two configurations."""

import asyncio
from dataclasses import dataclass

import structlog

from guarded_opcua import ServerSettings
from valvemap.app.build import build_identification
from valvemap.app.connections import build_server_settings, build_sources
from valvemap.app.warm_up import warm_up
from valvemap.config.models import Config
from valvemap.pipeline.identification import Identification
from valvemap.runtime.sources import Sources

log = structlog.get_logger(__name__)


class Compilation:
    """Compiling what a configuration needs, or loading what was compiled before, in a thread."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._task: asyncio.Task[None] | None = None

    def begin(self) -> asyncio.Task[None]:
        """Begin with it, if it was not begun."""
        if self._task is None:
            compile_all = asyncio.to_thread(warm_up, self._config, _show_progress)
            self._task = asyncio.create_task(compile_all)
        return self._task

    async def ended(self) -> None:
        """Wait for the end of it."""
        await asyncio.shield(self.begin())


@dataclass(frozen=True)
class Plan:
    """What runs between two configurations."""

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
    """Make all that a configuration asks for."""
    settings = server_settings or build_server_settings(config)
    identification = identification or build_identification(config)
    compiled = Compilation(config)
    source = build_sources(config, compiled.ended)  # until then samples wait at the source
    return Plan(config, settings, identification, source, compiled, server_settings, after_another)


def _show_progress(done: int, of: int) -> None:
    log.info("compiling, at the first start only", part=done + 1, of=of)
