"""``valvemap fleet serve``: an OPC UA server with one site's results, read from their topic."""

import asyncio
from contextlib import ExitStack, nullcontext
from functools import partial

import structlog

from guarded_opcua import ServerSettings
from valvemap.app.connections import (
    build_history,
    build_live_settings,
    build_server_settings,
    own_certificate,
)
from valvemap.app.limits import allow_descriptors, descriptors_needed
from valvemap.app.warm_up import warm_up
from valvemap.daemon_thread import in_daemon_thread, unless_stopped
from valvemap.errors import BrokerAway, FleetError
from valvemap.kafka.catalogue import groups_of, load_catalogue, site_of
from valvemap.kafka.decoding import Decoder
from valvemap.kafka.group import Group
from valvemap.kafka.reading import CommandPost, ResultsReader
from valvemap.kafka.result_blocks import ResultsBlock
from valvemap.kafka.settings import FleetConfig
from valvemap.kafka.site_results import Show
from valvemap.opcua_results.results_server import ResultsServer
from valvemap.runtime.backoff import backoff

log = structlog.get_logger(__name__)


async def serve(
    config: FleetConfig,
    site: str | None,
    stop: asyncio.Event,
    server_settings: ServerSettings | None = None,
) -> None:
    """Publish the results of a site until ``stop`` is set; without a name, of the only site.

    ``server_settings`` override the site's configuration.

    Raises
    ------
    ValvemapError
        at the start: of configuration, topics, the server's address.
    """
    catalogue = load_catalogue(config.catalogue)
    name = site_of(catalogue, site)
    given = catalogue.sites[name]
    settings = server_settings or build_server_settings(given)
    allow_descriptors(descriptors_needed(settings.limits.connections, sources=0))
    if not await unless_stopped(stop, in_daemon_thread(partial(warm_up, given))):
        return
    with ExitStack() as opened:
        past = opened.enter_context(build_history(given) or nullcontext())
        groups = {
            group.name: Group(group, catalogue.version) for group in groups_of(catalogue, name)
        }
        descriptions = [
            one for group in groups.values() for one in group.identification.descriptions()
        ]
        decoder = Decoder(catalogue, config.topics)
        reader = ResultsReader(
            config, f"serve.{name}", groups, decoder, keeps_history=past is not None
        )
        opened.callback(reader.close)
        post = CommandPost(config)
        opened.callback(post.close)
        show = Show(catalogue, name, config, groups, post, past)
        server = ResultsServer(
            settings,
            descriptions,
            show.operator,
            scalars_interval_s=given.server.results_interval_ms * 1e-3,
            past=past,
            on_alarm=show.keep,
        )
        certificate = own_certificate(given) if settings.pki else None
        show.certificate_until_ns = build_live_settings(given, certificate).certificate_until_ns
        kept = await _begun(reader, stop)
        if kept is None:
            return
        blocks = await asyncio.to_thread(_everything, groups, kept)
        async with server:
            await show.first(server, blocks)
            log.info("results served", url=server.url, site=name)
            await show.run(server, reader, stop)


async def _begun(reader: ResultsReader, stop: asyncio.Event) -> dict[str, bytes] | None:
    """Return the newest checkpoints, once the broker is reachable; None if ``stop`` is set."""
    for pause in backoff():
        try:
            return dict(await asyncio.to_thread(reader.begin))
        except BrokerAway as error:
            log.warning("waiting for the broker", reason=str(error), next_try_in_s=pause)
        try:
            async with asyncio.timeout(pause):
                await stop.wait()
        except TimeoutError:
            continue
        break
    return None


def _everything(groups: dict[str, Group], kept: dict[str, bytes]) -> list[ResultsBlock]:
    """Restore all checkpoints and return their results; clears ``groups``."""
    blocks: list[ResultsBlock] = []
    for name, group in groups.items():
        if name not in kept:
            log.info("no results yet", group=name)
            continue
        try:
            group.remember(kept[name])
            blocks += group.everything()
        except FleetError as error:
            log.warning("kept results rejected; waiting for its next results", reason=error)
    groups.clear()
    return blocks
