"""Publishing of our server to a client, over TCP, each in a separate process.

``python -m benchmarks.publish`` prints the figures as JSON; the functions return them.
"""

import argparse
import asyncio
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np

from guarded_opcua import Limits, Pki, Role, ServerSettings, UserStore, trust
from guarded_opcua.security.own_certificate import ensure_certificate
from valvemap.opcua_client.source_settings import Security, SourceSettings
from valvemap.opcua_source.client import OpcUaSource
from valvemap.opcua_source.source_nodes import ValveNodes
from valvemap.vocabulary.signals import Signal
from valvemap_rig.fleet_server import FleetServer
from valvemap_rig.scenario import BUILTIN, Fleet

URI, CLIENT_URI = "urn:benchmark:rig", "urn:benchmark:client"
PASSWORD = "benchmark"  # noqa: S105 - of a server that lives for a minute
_PER_VALVE = len(Signal)


async def fleet(
    valves: int, rate_hz: float, seconds: float, *, secured: bool = False, warm_s: float = 3.0
) -> dict[str, Any]:
    """Let a fleet play to our client.

    Returns
    -------
    dict
        ``notifications_per_s``; while it was measured ``lost`` (gaps in the sequences) and
        ``overflows`` (the server's word); ``lost_while_subscribing``, before the queues were read;
        ``client_cpu`` and ``server_cpu``, shares of a core.
    """
    with tempfile.TemporaryDirectory() as folder:
        async with _rig(valves, rate_hz, Path(folder), secured=secured) as (url, ask):
            source = OpcUaSource(_settings(url, Path(folder), secured=secured), _nodes(valves))
            await source.connect()
            try:
                await count_changes(source, warm_s)
                before, heard = await ask(), source.counters
                cpu, start = time.process_time(), time.perf_counter()
                found = await count_changes(source, seconds)
                elapsed = time.perf_counter() - start
                own = time.process_time() - cpu
                after = await ask()
            finally:
                await source.close()
            counters = source.counters
    return {
        "valves": valves,
        "rate_hz": rate_hz,
        "secured": secured,
        "notifications_per_s": found["notifications"] / elapsed,
        "lost": found["gaps"] + counters.missing_messages - heard.missing_messages,
        "overflows": counters.overflows - heard.overflows + after["lost"] - before["lost"],
        "lost_while_subscribing": before["lost"],
        "client_cpu": own / elapsed,
        "server_cpu": (after["cpu"] - before["cpu"]) / elapsed,
        "late_ticks": after["late_ticks"] - before["late_ticks"],
    }


async def count_changes(source: OpcUaSource, seconds: float) -> dict[str, int]:
    """Receive notifications; every valve's Sequence must grow by one."""
    end = time.perf_counter() + seconds
    notifications = gaps = 0
    last: dict[str, np.ndarray] = {}
    while time.perf_counter() < end:
        changes = await source.receive()
        notifications += len(changes)
        mine = changes.item % _PER_VALVE == Signal.SEQUENCE
        valve, number = changes.item[mine] // _PER_VALVE, changes.value[mine]
        order = np.argsort(valve, kind="stable")
        valve, number = valve[order], number[order]
        same = valve[1:] == valve[:-1]
        gaps += int((np.diff(number)[same] != 1).sum())
        first = np.flatnonzero(np.r_[True, ~same]) if len(valve) else np.empty(0, np.intp)
        ends = np.r_[first[1:], len(valve)] - 1 if len(valve) else first
        if "of" in last:
            known = last["of"][valve[first]]
            gaps += int(((number[first] != known + 1) & ~np.isnan(known)).sum())
        else:
            last["of"] = np.full(100_000, np.nan)
        last["of"][valve[first]] = number[ends]
    return {"notifications": notifications, "gaps": gaps}


def _nodes(valves: int) -> list[ValveNodes]:
    width = len(str(valves))
    names = [f"Valvistor{number:0{width}d}" for number in range(1, valves + 1)]
    return [
        ValveNodes(
            name,
            *(f"nsu={URI};s={name}.{last}" for last in ("U", "p1", "p2", "Q", "Temperature")),
            sequence=f"nsu={URI};s={name}.Sequence",
        )
        for name in names
    ]


def _settings(url: str, folder: Path, *, secured: bool) -> SourceSettings:
    if not secured:
        return SourceSettings(url, publishing_interval_ms=50.0, timeout_s=30.0)
    pki = Pki(folder / "client")
    return SourceSettings(
        url,
        security=Security.BASIC256_SHA256,
        pki=pki,
        own=ensure_certificate(pki, CLIENT_URI, ("localhost", "127.0.0.1"), "client"),
        user="operator",
        password=PASSWORD,
        publishing_interval_ms=50.0,
        timeout_s=30.0,
    )


@asynccontextmanager
async def _rig(
    valves: int, rate_hz: float, folder: Path, *, secured: bool
) -> AsyncIterator[tuple[str, Any]]:
    """Start a fleet in its own process; ``ask`` returns its counters."""
    if secured:
        ours, its = Pki(folder / "client"), Pki(folder / "rig")
        names = ("localhost", "127.0.0.1")
        trust(its, ensure_certificate(ours, CLIENT_URI, names, "client").certificate)
        trust(ours, ensure_certificate(its, URI, names, "benchmark-rig").certificate)
    wish = json.dumps([valves, rate_hz, str(folder) if secured else None])
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        __spec__.name if __spec__ else "benchmarks.publish",
        "--serve",
        wish,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert process.stdin is not None  # noqa: S101 - see above
    assert process.stdout is not None  # noqa: S101

    async def ask() -> dict[str, Any]:
        process.stdin.write(b"?\n")
        return json.loads(await process.stdout.readline())

    try:
        url = json.loads(await process.stdout.readline())["url"]
        yield url, ask
    finally:
        process.stdin.close()
        await process.wait()


async def _serve(valves: int, rate_hz: float, folder: str | None) -> None:
    users = UserStore()
    users.add("operator", Role.OPERATOR, PASSWORD)
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/",
        application_uri=URI,
        application_name="benchmark rig",
        namespace_uri=URI,
        pki=None if folder is None else Pki(Path(folder) / "rig"),
        users=users,
        none_on_loopback=folder is None,
        limits=Limits(),
    )
    scenario = BUILTIN["demo"].model_copy(
        update={"fleet": Fleet(valves=valves), "sample_rate_hz": rate_hz}
    )
    async with await FleetServer.create(settings, scenario) as server:
        print(json.dumps({"url": server.url}), flush=True)
        playing = asyncio.create_task(server.run())
        reader = asyncio.StreamReader()
        await asyncio.get_running_loop().connect_read_pipe(
            lambda: asyncio.StreamReaderProtocol(reader), sys.stdin
        )
        while await reader.readline():
            seen = {
                "cpu": time.process_time(),
                "lost": server.lost,
                "late_ticks": server.late_ticks,
                "samples": server.samples,
            }
            print(json.dumps(seen), flush=True)
        playing.cancel()
        await asyncio.gather(playing, return_exceptions=True)


def main() -> None:
    """Measure, or run the server."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--serve", type=json.loads, help=argparse.SUPPRESS)
    parser.add_argument("--valves", type=int, default=1_000)
    parser.add_argument("--rate", type=float, default=200.0)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--secured", action="store_true")
    asked = parser.parse_args()
    if asked.serve is not None:
        asyncio.run(_serve(*asked.serve))
        return
    figures = asyncio.run(fleet(asked.valves, asked.rate, asked.seconds, secured=asked.secured))
    print(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
