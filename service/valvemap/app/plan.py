"""The objects that run under one configuration."""

from dataclasses import dataclass

from guarded_opcua import ServerSettings
from valvemap.app.build import build_identification
from valvemap.app.connections import build_axis_sources, build_server_settings, build_sources
from valvemap.app.staged_start import Compilation
from valvemap.config.models import Config
from valvemap.pipeline.identification import Identification
from valvemap.runtime.sources import Sources


@dataclass(frozen=True)
class Plan:
    """The objects that run under one configuration."""

    config: Config
    settings: ServerSettings
    identification: Identification
    source: Sources
    axis_source: Sources
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
    wait = compiled.ended if identification.journal is None else None
    source = build_sources(config, wait)  # until then samples wait at the source
    return Plan(
        config,
        settings,
        identification,
        source,
        build_axis_sources(config, compiled.ended),
        compiled,
        server_settings,
        after_another,
    )
