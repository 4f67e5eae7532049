"""Harm by hostile peers: ``python -m benchmarks.hostile [--seconds S] [LOAD...]``.

Each class of load runs against a fresh server, ours and a plain asyncua server as the baseline,
while a second client reads and subscribes; server, attacker and client are separate processes.
Prints the table of docs/hostile.md and writes it to benchmarks/results/hostile.json.
"""

import argparse
import asyncio
import contextlib
import json
import os
import platform
import socket
import sys
import tempfile
import time
from importlib.metadata import version
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.hostile_loads import LOADS

RESULTS = Path(__file__).parent / "results" / "hostile.json"
START_S, SETTLE_S, ANSWER_S = 60.0, 1.0, 60.0
SAMPLE_S = 0.05
WITNESS = {"ours": "operator", "plain": "anybody"}
MOST_RSS, MOST_MEDIAN, MOST_WORST, WORST_MS = 1.5, 2.0, 3.0, 250.0
MOST_LOG = 16 * 1024  # bytes a second: a bounded number of each kind of line in ten seconds


def failings(row):
    """Name the bars that a row misses.

    >>> row = {"rss_ratio": 1.6, "log_bytes_per_s": 10, "served": True, "lost": 0,
    ...        "quiet": {"median_ms": 1.0, "worst_ms": 10.0, "gap_ms": 20.0},
    ...        "loaded": {"median_ms": 1.5, "worst_ms": 240.0, "gap_ms": 30.0}}
    >>> failings(row)
    ['memory']
    """
    quiet, loaded = row["quiet"], row["loaded"]
    missed = {
        "memory": row["rss_ratio"] is not None and row["rss_ratio"] > MOST_RSS,
        "median": loaded is None or loaded["median_ms"] > MOST_MEDIAN * quiet["median_ms"],
        "worst": loaded is None
        or loaded["worst_ms"] > max(WORST_MS, MOST_WORST * quiet["worst_ms"]),
        "gap": loaded is None or loaded["gap_ms"] > max(WORST_MS, MOST_WORST * quiet["gap_ms"]),
        "lost": row["lost"] is None or row["lost"] > 0 or not row["served"],
        "log": row["log_bytes_per_s"] > MOST_LOG,
    }
    return [name for name, is_missed in missed.items() if is_missed]


async def measured(server_kind, load, seconds):
    """Return the row of one load against one server."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    url = f"opc.tcp://127.0.0.1:{port}/"
    with tempfile.TemporaryFile() as log:
        server = await started("benchmarks.hostile_server", server_kind, port, errors=log)
        witness = attacker = sampling = None
        try:
            await said_ready(server)
            witness = await started("benchmarks.hostile_witness", url, WITNESS[server_kind])
            await said_ready(witness)
            await asyncio.sleep(min(seconds, 5.0))
            quiet = await told(witness)
            base, before, began = rss(server.pid), size(log), time.monotonic()
            peak = [base]
            sampling = asyncio.create_task(watched(server.pid, peak))
            attacker = await started("benchmarks.hostile_loads", load, url, seconds)
            await asyncio.wait_for(attacker.wait(), 10 * seconds + 300.0)
            loaded = await told(witness)
            written = (size(log) - before) / (time.monotonic() - began)
        finally:
            if sampling is not None:
                sampling.cancel()
            for process in (attacker, witness, server):
                if process is not None and process.returncode is None:
                    process.kill()
                    await process.wait()
    return row_of(quiet, loaded, base, max(filter(None, peak), default=None), written)


def row_of(quiet, loaded, base, peak, written):
    lost = None
    if loaded is not None and loaded["last"] is not None:
        lost = loaded["last"] - loaded["first"] + 1 - loaded["got"]
    row = {
        "rss_base": base,
        "rss_ratio": peak / base if base and peak else None,
        "quiet": quiet,
        "loaded": loaded,
        "lost": lost,
        "served": loaded is not None and loaded["reads"] > 0 and loaded["got"] > 1,
        "log_bytes_per_s": written,
    }
    return {**row, "missed": failings(row)}


async def started(module, *arguments, errors=None):
    return await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        module,
        *map(str, arguments),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=errors or asyncio.subprocess.DEVNULL,
    )


async def said_ready(process):
    line = await asyncio.wait_for(process.stdout.readline(), START_S)
    if line.strip() != b"ready":
        raise RuntimeError("a process of the benchmark did not start")


async def told(witness):
    """Return what the second client felt since it was asked last, None if it cannot say."""
    with contextlib.suppress(TimeoutError, OSError, ValueError):
        witness.stdin.write(f"{SETTLE_S}\n".encode())
        await witness.stdin.drain()
        return json.loads(await asyncio.wait_for(witness.stdout.readline(), ANSWER_S))
    return None


async def watched(pid, peak):
    while True:
        peak.append(rss(pid))
        await asyncio.sleep(SAMPLE_S)


def rss(pid):
    """Resident memory of a process, bytes; None where the system does not tell it so."""
    try:
        pages = Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]
    except (OSError, IndexError):
        return None
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


def size(file):
    return os.fstat(file.fileno()).st_size


def shown(rows):
    """Return the table as Rich shows it."""
    table = Table(title="Hostile peers: a second client, quiet → under load")
    for column in (
        "load",
        "server",
        "RSS ×",
        "median ms",
        "worst ms",
        "gap ms",
        "lost",
        "log kB/s",
        "missed",
    ):
        table.add_column(column)
    for load, by_server in rows.items():
        for server, row in by_server.items():
            table.add_row(load, server, *cells(row))
    return table


def cells(row):
    quiet, loaded = row["quiet"], row["loaded"]
    ratio = row["rss_ratio"]
    return (
        "?" if ratio is None else f"{ratio:.2f}",
        f"{quiet['median_ms']:.1f} → " + (f"{loaded['median_ms']:.1f}" if loaded else "–"),
        f"{quiet['worst_ms']:.0f} → " + (f"{loaded['worst_ms']:.0f}" if loaded else "–"),
        f"{quiet['gap_ms']:.0f} → " + (f"{loaded['gap_ms']:.0f}" if loaded else "–"),
        "all" if not row["served"] else str(row["lost"]),
        f"{row['log_bytes_per_s'] / 1e3:.1f}",
        ", ".join(row["missed"]) or "–",
    )


async def main(arguments):
    rows = {}
    for load in arguments.loads or LOADS:
        rows[load] = {}
        for server in ("ours", "plain")[: 1 if arguments.ours_only else 2]:
            print(f"{load}: {server}", file=sys.stderr, flush=True)
            rows[load][server] = await measured(server, load, arguments.seconds)
    RESULTS.parent.mkdir(exist_ok=True)
    machine = {
        "python": platform.python_version(),
        "asyncua": version("asyncua"),
        "cores": os.cpu_count(),
    }
    RESULTS.write_text(json.dumps({"machine": machine, "rows": rows}, indent=1), encoding="utf-8")
    Console(width=120).print(shown(rows))
    return int(any(by_server["ours"]["missed"] for by_server in rows.values()))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("loads", nargs="*", choices=[*LOADS, []], metavar="LOAD")
    parser.add_argument("--seconds", type=float, default=5.0, help="how long each load lasts")
    parser.add_argument("--ours-only", action="store_true", help="without the baseline")
    sys.exit(asyncio.run(main(parser.parse_args())))
