"""What the history costs, and how fast it answers: ``-m benchmarks.history_speed [PART ...]``.

Parts: ``beside``, samples kept while a fleet is identified in the default configuration; ``day``,
how long a client waits for trends of a day; ``memory``, what history and alarms add to a service of
a thousand valves that runs. Without any, all.
"""

import asyncio
import datetime as dt
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from asyncua import Client, ua

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from benchmarks import live_speed
from benchmarks.live_speed import free_url, names_of, rig, running
from benchmarks.reliability_load import Service, service_of
from valvemap.config.stores import HistoryConfig
from valvemap.config.valves import NodesConfig, ValveConfig
from valvemap.opcua_results.results_server import NAMESPACE
from valvemap.pipeline.store_ports import Piece
from valvemap.storage.history import HistoryFile
from valvemap.vocabulary.signals import PUBLISHED

VALVES, HZ, SECONDS = 100, 100.0, 60.0
DAY_S, DAY_HZ, BUCKETS, RAW = 86_400, 100, 2_000, 100_000
AGGREGATES = "Average", "Minimum", "Maximum"
AT_ONCE = 100_000  # rows saved at once while a day is made
MANY, MANY_HZ, SETTLED_S = 1_000, 10.0, 60.0

Figures = dict[str, float]


def beside() -> Figures:
    """Values of signals kept per second beside a running identification, and losses."""
    with tempfile.TemporaryDirectory() as name:
        folder, url = Path(name), free_url("rig")
        kept = folder / "history.sqlite"
        config = live_speed.open_config(names_of(VALVES), folder, url)
        default = ValveConfig(name="V", nodes=NodesConfig.of_rig("V")).estimators
        valves = tuple(v.model_copy(update={"estimators": default}) for v in config.valves)
        config = config.model_copy(update={"valves": valves, "history": HistoryConfig(file=kept)})
        with rig(VALVES, HZ, url, {}):
            found = asyncio.run(live_speed.live(config, HZ, SECONDS, secured=False))
        with HistoryFile(kept) as file:
            rows = _rows(file, config.valves[0].name)
    return {
        "samples/s learnt": found["reached, notifications/s"] / live_speed.PUBLISHED,
        "values of signals kept per second": found["reached, notifications/s"],  # dp for Sequence
        "samples lost": found["lost"],
        "cores of the service": found["cores of the service"],
        "steps other than 10 ms among a valve's kept rows": rows,
    }


def _rows(file: HistoryFile, valve: str) -> float:
    past = file.read(f"{valve}.Signals", "Q", 0, 2**62, most=10**9)
    return float((np.diff(past.t) != round(1e9 / HZ)).sum())


def day() -> Figures:
    """Seconds that a client waits for trends of a day of one signal at 100 Hz.

    ``answered`` is without asyncua's own unpacking of the answers, value by value.
    """
    with tempfile.TemporaryDirectory() as name:
        folder, url = Path(name), free_url("service")
        kept, file = folder / "history.sqlite", folder / "service.toml"
        start = (time.time_ns() // 10**9 - DAY_S - 3_600) * 10**9
        _make_day(kept, start)
        file.write_text(
            f'[source]\nurl = "{free_url("nobody")}"\nsecurity = "None"\n'
            f'startup_timeout_s = 600.0\n[server]\nurl = "{url}"\n'
            f'[state]\nfile = "{folder}/state.sqlite"\n[history]\nfile = "{kept}"\n'
            '[[valves]]\nname = "V"\n',
            encoding="utf-8",
        )
        with running(["benchmarks.start_up", "serve", str(file)], {}):
            return asyncio.run(_trends(url, start))


def _make_day(path: Path, start: int) -> None:
    rng = np.random.default_rng(0)
    with HistoryFile(path) as store:
        for first in range(0, DAY_S * DAY_HZ, AT_ONCE):
            k = np.arange(first, min(first + AT_ONCE, DAY_S * DAY_HZ))
            columns = {name: 50.0 + np.cumsum(rng.normal(size=len(k))) for name in PUBLISHED}
            t, good = start + k * (10**9 // DAY_HZ), np.zeros(len(k), np.uint32)
            store.save([Piece("V.Signals", t, good, columns)])


async def _trends(url: str, start: int) -> Figures:
    low, found = dt.datetime.fromtimestamp(start / 1e9, dt.UTC), dict[str, float]()
    high = low + dt.timedelta(seconds=DAY_S)
    until = low + dt.timedelta(seconds=RAW / DAY_HZ)
    config = ua.AggregateConfiguration(UseServerCapabilitiesDefaults=True)
    async with Client(url, timeout=60, watchdog_intervall=60) as client:
        index = await client.get_namespace_index(NAMESPACE)
        node = ua.NodeId("V.Signals.Q", index)
        for name in AGGREGATES:
            kind = ua.NodeId(getattr(ua.ObjectIds, f"AggregateFunction_{name}"))
            each = DAY_S * 1_000.0 / BUCKETS
            details = ua.ReadProcessedDetails(low, high, each, [kind], config)
            values, answered, whole = await _history(client, node, details)
            found |= {f"{BUCKETS:,} x {name} ({values} values), answered": answered}
            found |= {f"{BUCKETS:,} x {name}, unpacked": whole}
        details = ua.ReadRawModifiedDetails(
            IsReadModified=False, StartTime=low, EndTime=until, NumValuesPerNode=0
        )
        values, answered, whole = await _history(client, node, details)
        found |= {f"{values:,} raw values, answered": answered}
        found |= {f"{values:,} raw values, unpacked": whole}
    return found


async def _history(
    client: Client,
    node: ua.NodeId,
    details: ua.ReadProcessedDetails | ua.ReadRawModifiedDetails,
) -> tuple[int, float, float]:
    """Values that came; s until the answers were there, and s with asyncua's unpacking of them."""
    values, answered, began, point = 0, 0.0, time.perf_counter(), None
    while True:
        request = ua.HistoryReadRequest()
        request.Parameters = ua.HistoryReadParameters(
            details,
            ReleaseContinuationPoints=False,
            NodesToRead=[ua.HistoryReadValueId(node, ContinuationPoint=point)],
        )
        asked = time.perf_counter()
        data = await client.uaclient.protocol.send_request(request)
        answered += time.perf_counter() - asked
        (result,) = ua.ua_binary.struct_from_binary(ua.HistoryReadResponse, data).Results
        result.StatusCode.check()
        values, point = values + len(result.HistoryData.DataValues), result.ContinuationPoint
        if not point:
            return values, answered, time.perf_counter() - began


def memory() -> Figures:
    """Resident MB of a service of a thousand valves at 10 Hz, without and with both."""
    found = {}
    for name, more in (("without history", ""), ("with history and alarms", "[history]\nfile = ")):
        with tempfile.TemporaryDirectory() as folder:
            section = f'{more}"{folder}/history.sqlite"\n' if more else ""
            with service_of(MANY, MANY_HZ, more=section) as service:
                found[f"{name}, MB"] = asyncio.run(_settled(service, listen=bool(more)))
    plain, both = found.values()
    return {**found, "ratio (bar 1.1)": both / plain}


async def _settled(service: Service, *, listen: bool) -> float:
    """Resident MB a minute later; with ``listen`` a client receives all alarms, twice."""
    async with Client(service.url, timeout=60, watchdog_intervall=60) as client:
        if listen:
            subscription = await client.create_subscription(500, _Heard())
            await subscription.subscribe_alarms_and_conditions(
                ua.ObjectIds.Server, ua.ObjectIds.ConditionType
            )
            await client.get_node(ua.ObjectIds.ConditionType).call_method(
                "0:ConditionRefresh",
                ua.Variant(subscription.subscription_id, ua.VariantType.UInt32),
            )
        await asyncio.sleep(SETTLED_S)
    return service.resident_mb()


class _Heard:
    """Takes events in."""

    def event_notification(self, _event: object) -> None:
        """Nothing is done with it."""


PARTS = {"beside": beside, "day": day, "memory": memory}


def main(arguments: Sequence[str]) -> int:
    """Measure and print."""
    for part in arguments or PARTS:
        print(part)
        for name, value in PARTS[part]().items():
            print(f"  {name:58} {value:12,.2f}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
