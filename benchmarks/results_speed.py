"""Results of many valves to our client: ``python -m benchmarks.results_speed [VALVES] [HZ] [S]``.

A results server (a separate process) learns one sample of each valve and publishes all results,
HZ times a second; the client subscribes to five numbers of every valve. ``SampleCount`` grows by
one with each result: a jump is a loss.
"""

import asyncio
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks import live_speed
from benchmarks.publish import count_changes
from guarded_opcua import Limits
from valvemap.app.build import build_identification
from valvemap.app.identities import APPLICATION_URI
from valvemap.app.warm_up import warm_up
from valvemap.cli.logs import set_up_logs
from valvemap.config.logs import LogConfig
from valvemap.opcua_client.source_settings import SourceSettings
from valvemap.opcua_results.results_server import ResultsServer
from valvemap.opcua_source.client import OpcUaSource
from valvemap.opcua_source.source_nodes import ValveNodes
from valvemap.pipeline.data_changes import DataChanges
from valvemap.vocabulary.signals import PER_VALVE

NUMBERS = "PredictedFlow", "Residual", "ResidualRmse", "NoiseStd"
WARM_S = 5.0
LIMITS = Limits(
    monitored_items=100_000,
    monitored_items_per_subscription=100_000,
    queued_notifications=2_000_000,
)


def measured(
    valves: int = 1_000, hz: float = 70.0, seconds: float = 15.0, *, warm_s: float = WARM_S
) -> dict[str, float]:
    """Notifications per second at the client, and losses."""
    set_up_logs(LogConfig(level="error"))
    url = live_speed.free_url("service")
    with live_speed.running(
        ["benchmarks.results_speed", "serve", url, str(valves), str(hz)], {}
    ) as pid:
        return {"valves": valves, **asyncio.run(_read(url, valves, seconds, warm_s, pid))}


async def _read(
    url: str, valves: int, seconds: float, warm_s: float, server: int
) -> dict[str, float]:
    prefix = f"nsu={APPLICATION_URI};s="
    nodes = [
        ValveNodes(
            name,
            *(f"{prefix}{name}.RLS.{number}" for number in NUMBERS),
            sequence=f"{prefix}{name}.RLS.SampleCount",
            insist=True,  # they are no signals
        )
        for name in _names(valves)
    ]
    source = OpcUaSource(SourceSettings(url, publishing_interval_ms=50.0, timeout_s=60.0), nodes)
    await source.connect()
    try:
        await count_changes(source, warm_s)
        served, cpu = live_speed.processor_time(server), time.process_time()
        began = time.perf_counter()
        found = await count_changes(source, seconds)
        took, cpu = time.perf_counter() - began, time.process_time() - cpu
        served = live_speed.processor_time(server) - served
    finally:
        await source.close()
    return {
        "notifications/s": found["notifications"] / took,
        "lost": found["gaps"] + source.counters.missing_messages + source.counters.overflows,
        "cores of the service": served / took,
        "cores of the client": cpu / took,
    }


async def _serve(url: str, valves: int, hz: float) -> None:
    with tempfile.TemporaryDirectory() as name:
        config = live_speed.open_config(_names(valves), Path(name), url)
        warm_up(config)
        identification = build_identification(config)
        settings = replace(live_speed.open_settings(config, LIMITS), url=url)
        server = ResultsServer(settings, identification.descriptions(), identification)
        async with server:
            print(url, flush=True)
            began, k = time.perf_counter(), 0
            while True:
                identification.take(_sample(valves, k))
                for results in identification.results.of(range(valves)):
                    await server.publish(results)
                k += 1
                await asyncio.sleep(max(0.0, began + k / hz - time.perf_counter()))


def _sample(valves: int, k: int) -> DataChanges:
    """One sample of every valve, all of the same time."""
    U, dp = 37.0 * k % 100.0, 1.0 + 61.0 * k % 200.0
    one = np.array([U, 200.0, 200.0 - dp, U * np.sqrt(dp) / 10.0, 40.0, float(k)])
    return DataChanges(
        item=np.arange(valves * PER_VALVE, dtype=np.int32),
        value=np.tile(one, valves),
        status=np.zeros(valves * PER_VALVE, np.uint32),
        source_time=np.full(valves * PER_VALVE, time.time_ns() // 100 * 100),
    )


def _names(valves: int) -> list[str]:
    return [f"V{k}" for k in range(valves)]


def main(arguments: list[str]) -> int:
    """Measure and print, or run the server."""
    if arguments[:1] == ["serve"]:
        asyncio.run(_serve(arguments[1], int(arguments[2]), float(arguments[3])))
        return 0
    given = [float(x) for x in arguments]
    valves, hz, seconds = given + [1_000.0, 70.0, 15.0][len(given) :]
    for name, value in measured(int(valves), hz, seconds).items():
        print(f"{name:20} {value:12,.3f}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
