"""Publishes results as Sparkplug B over MQTT, in a separate process from the service."""

import asyncio
from functools import partial
from typing import Any

from valvemap.app.metrics_address import MetricsAddress
from valvemap.app.mqtt_metrics import mqtt_points
from valvemap.app.page_access import Watched, settings_of
from valvemap.app.serving_metrics import metrics_served
from valvemap.clock import SystemClock
from valvemap.config.mqtt import MqttConfig
from valvemap.config.secret_files import read_secret
from valvemap.opcua_client.results_client import ResultsClient
from valvemap.opcua_results.namespaces import SERVICE_NAMESPACE
from valvemap.runtime.backoff import backoff
from valvemap.sparkplug.broker import PahoBroker
from valvemap.sparkplug.commands import Commands
from valvemap.sparkplug.edge_node import EdgeNode
from valvemap.sparkplug.host import PrimaryHost
from valvemap.sparkplug.outbox import Outbox
from valvemap.sparkplug.reader import Reader
from valvemap.sparkplug.sender import Sender
from valvemap.sparkplug.settings import BrokerSettings
from valvemap.sparkplug.shown import Shown
from valvemap.sparkplug.structures import Flat, Structure
from valvemap.sparkplug.templates import Templates

_CANCEL_AGAIN_S = 10.0  # s; longer than the farewells to broker and service take
_TIMEOUT_S = 5.0  # s; of every request to the service


async def run_mqtt(
    config: MqttConfig,
    watched: Watched,
    stop: asyncio.Event,
    address: MetricsAddress | None = None,
) -> None:
    """Publish results until ``stop`` is set; serve metrics at ``address``, if there is one.

    Raises
    ------
    ValvemapError
        if a certificate, key or password file, or the address, cannot be used.
    """
    clock = SystemClock()
    outbox = Outbox(config.most_waiting)
    shown = Shown(outbox, clock.now())
    service = ResultsClient(settings_of(watched, _TIMEOUT_S), SERVICE_NAMESPACE)
    broker = PahoBroker(build_broker(config))
    structure: Structure = Templates() if config.structure == "templates" else Flat()
    node = EdgeNode(config.group, config.edge_node, structure)
    every_s = config.interval_s
    commands = None
    if config.commands:
        commands = Commands(config.commands, shown, structure.prefix, config.command_max_age_s)
    reader = Reader(service, shown, config.variables, every_s, clock, backoff, commands)
    host = None if config.primary_host is None else PrimaryHost(config.primary_host)
    sender = Sender(broker, node, shown, outbox, every_s, clock, backoff, host, commands)
    with metrics_served(address, partial(mqtt_points, shown, outbox, sender, config.most_waiting)):
        await _run_until_stopped(reader, sender, stop)


async def _run_until_stopped(reader: Reader, sender: Sender, stop: asyncio.Event) -> None:
    tasks = [asyncio.create_task(run) for run in (reader.run(), sender.run(), stop.wait())]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        for task in reversed(tasks):  # the sender publishes NDEATH while the reader still runs
            await _ended(task)


async def _ended(task: "asyncio.Task[Any]") -> None:
    """Cancel until the task ends: `asyncio.wait_for` of Python 3.11 may lose a cancellation."""
    while not task.done():
        task.cancel()
        await asyncio.wait({task}, timeout=_CANCEL_AGAIN_S)
    await asyncio.gather(task, return_exceptions=True)


def build_broker(config: MqttConfig) -> BrokerSettings:
    """Return the connection settings of the broker.

    Raises
    ------
    ConfigurationError
        if the password file cannot be read.
    """
    host, port = config.address
    return BrokerSettings(
        host=host,
        port=port,
        client_id=config.client_id or f"valvemap-{config.group}-{config.edge_node}",
        tls=config.tls,
        ca_file=config.ca_file,
        certificate_file=config.certificate_file,
        key_file=config.key_file,
        user=config.user,
        password=None if config.password_file is None else read_secret(config.password_file),
        keep_alive_s=config.keep_alive_s,
        timeout_s=config.timeout_s,
    )
