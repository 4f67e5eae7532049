"""``valvemap fleet collect``: one site's sources, aligned and published as blocks of samples."""

import asyncio
from functools import partial

import structlog

from valvemap.app.connections import build_sources, build_supervisor_settings
from valvemap.app.metrics_address import MetricsAddress
from valvemap.app.serving_metrics import metrics_served
from valvemap.app.warm_up_parts import compile_alignment
from valvemap.clock import SystemClock
from valvemap.kafka.catalogue import load_catalogue, site_of
from valvemap.kafka.collector import Collector
from valvemap.kafka.collector_metrics import collector_points
from valvemap.kafka.sending import Sender
from valvemap.kafka.settings import FleetConfig
from valvemap.kafka.spool import Spool
from valvemap.runtime.sources import supervise_all

log = structlog.get_logger(__name__)


async def collect(
    config: FleetConfig,
    site: str | None,
    stop: asyncio.Event,
    address: MetricsAddress | None = None,
) -> None:
    """Collect the samples of a site until ``stop`` is set; without a name, of the only site.

    Metrics are served at ``address``, if there is one.

    Raises
    ------
    ConfigurationError, FleetError, SourceError, StorageError
        at the start; an unreachable broker is retried.
    PageError
        if the address of the metrics cannot be used.
    """
    catalogue = load_catalogue(config.catalogue)
    name = site_of(catalogue, site)
    compile_alignment(catalogue.sites[name])
    file = config.collect.spool / f"{name}.sqlite"
    loop = asyncio.get_running_loop()
    with Spool(file, round(config.collect.most_mb * 1e6)) as spool:
        sender = Sender(config, spool, lambda: loop.call_soon_threadsafe(stop.set))
        sources = build_sources(catalogue.sites[name])
        collector = Collector(catalogue, name, config, sources, spool)
        collector.resume()
        with metrics_served(address, partial(collector_points, collector, sender, spool)):
            sender.start()
            log.info("collecting", site=name, valves=len(catalogue.sites[name].valves))
            try:
                supervision = build_supervisor_settings(catalogue.sites[name])
                await supervise_all(sources, collector, SystemClock(), stop, supervision)
            finally:
                await collector.finish()
                await asyncio.to_thread(sender.stop)
        if sender.hopeless is not None:
            raise sender.hopeless
