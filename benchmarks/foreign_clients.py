"""Clients of other stacks on the same fleet: ``python -m benchmarks.foreign_clients``.

``[VALVES] [HZ] [SECONDS]`` follow. Our service, which learns with RLS, and gopcua, async-opcua and
Milo, which count, each subscribe in turn to all signals of a separate rig that plays the same.
They are built once, into ``build/clients``; see ``clients/README.md``.
"""

import asyncio
import hashlib
import os
import re
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Final

from asyncua import Client

from benchmarks import live_speed
from valvemap.config.valves import NodesConfig
from valvemap.opcua_results.namespaces import RIG_NAMESPACE

SOURCES: Final = Path(__file__).with_name("clients")
BUILT: Final = Path(__file__).parents[1] / "build" / "clients"
BUILD_S: Final = 1_500.0  # longest build: Rust's takes minutes
SETTLING_S: Final = 5.0  # from the first notification on
PATIENCE_S: Final = 60.0  # for the first notification
LOST_BY_SAMPLE: Final = live_speed.SIGNALS  # notifications

Figures = dict[str, float]


class Missing(Exception):  # noqa: N818 - no error: it is left out
    """Tell why a client cannot be built here."""


@dataclass(frozen=True)
class ForeignClient:
    """Sources in a folder of `SOURCES`, the program that builds them, and the command that runs it.

    ``pinned``: the file of them that pins the stack's version, and how it does.
    """

    folder: str
    build: tuple[str, ...]
    run: tuple[str, ...]
    pinned: tuple[str, str]
    needs: tuple[str, ...] = ()


CLIENTS: Final = {
    "gopcua": ForeignClient(
        "gopcua",
        ("go", "build", "-o", "bin/", ".", "./every"),
        ("bin/gopcua",),
        ("go.mod", r"gopcua/opcua v([\d.]+)"),
    ),
    "async-opcua": ForeignClient(
        "async_opcua",
        ("cargo", "build", "--quiet", "--release", "--locked", "--target-dir", "target"),
        ("target/release/counter",),
        ("Cargo.toml", r'async-opcua-client = "=([\d.]+)"'),
    ),
    "Milo": ForeignClient(
        "milo",
        ("mvn", "--quiet", "--batch-mode", "compile"),
        ("java", "-cp", os.pathsep.join(("target/classes", "target/lib/*")), "valvemap.Counter"),
        ("pom.xml", r"milo-sdk-client</artifactId>\s*<version>([\d.]+)"),
        needs=("java",),
    ),
}


def built(name: str) -> Path:
    """Return the folder in which a client can be run, built there if it is not yet.

    Raises
    ------
    Missing
    """
    client = CLIENTS[name]
    absent = [tool for tool in (client.build[0], *client.needs) if shutil.which(tool) is None]
    if absent:
        raise Missing(f"{', '.join(absent)} not installed")
    folder = SOURCES / client.folder
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    content = hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:16]
    target = BUILT / f"{client.folder}-{content}"
    if not (target / "ready").exists():
        shutil.rmtree(target, ignore_errors=True)
        shutil.copytree(folder, target)
        try:
            done = subprocess.run(
                client.build,
                cwd=target,
                capture_output=True,
                text=True,
                timeout=BUILD_S,
                check=False,
            )
        except subprocess.TimeoutExpired as late:
            raise Missing(f"{client.build[0]} took longer than {BUILD_S:g} s") from late
        if done.returncode:
            said = (done.stderr + done.stdout).strip()
            raise Missing(f"{' '.join(client.build)} failed: {said[-300:]}")
        (target / "ready").touch()
    return target


def versions() -> dict[str, str]:
    """Which versions of the stacks are built."""
    found = {}
    for name, client in CLIENTS.items():
        file, pattern = client.pinned
        pin = re.search(pattern, (SOURCES / client.folder / file).read_text("utf-8"))
        assert pin is not None  # noqa: S101 - see the test of it
        found[name] = pin[1]
    return found


def measured(valves: int = 1_000, hz: float = 170.0, seconds: float = 30.0) -> Figures:
    """Notifications per second, notifications lost, and cores used, of each."""
    ours = live_speed.measured(valves, hz, seconds)
    found = {
        "ours, with RLS: notifications/s": ours["reached, notifications/s"],
        "ours, with RLS: lost": ours["lost"] * LOST_BY_SAMPLE,
        "ours, with RLS: cores": ours["cores of the service"],
    }
    for name in CLIENTS:
        try:
            figures = counted(name, valves, hz, seconds)
        except Missing as why:
            print(f"{name}: {why}", file=sys.stderr)
            continue
        found |= {f"{name}, counting: {what}": figure for what, figure in figures.items()}
    return found


def counted(name: str, valves: int, hz: float, seconds: float) -> Figures:
    """Notifications of a fleet that a client of another stack receives.

    Raises
    ------
    Missing
    RuntimeError
        with its message, if it failed.
    """
    folder, url = built(name), live_speed.free_url("rig")
    with live_speed.rig(valves, hz, url, {}):
        nodes = asyncio.run(_nodes(url, valves))
        with _running(folder, CLIENTS[name].run, url, nodes) as (pid, lines):
            began = next((t for t, received, _ in lines if received), None)
            first = cpu = last = None
            for t, received, lost in lines:
                if began is not None and first is None and t - began >= SETTLING_S:
                    first, cpu = (t, received, lost), live_speed.processor_time(pid)
                if first is not None and t - first[0] >= seconds:
                    last, used = (t, received, lost), live_speed.processor_time(pid)
                    break
    if first is None or last is None or cpu is None:
        raise RuntimeError(f"{name} gave up")
    took = last[0] - first[0]
    return {
        "notifications/s": (last[1] - first[1]) / took,
        "lost": (last[2] - first[2]) * LOST_BY_SAMPLE,
        "cores": (used - cpu) / took,
    }


async def _nodes(url: str, valves: int) -> list[str]:
    """NodeIds of all signals of a fleet, as every stack reads them."""
    async with Client(url) as client:
        index = await client.get_namespace_index(RIG_NAMESPACE)
    signals = "U", "p1", "p2", "Q", "T", "sequence"
    return [
        getattr(NodesConfig.of_rig(name), signal).replace(f"nsu={RIG_NAMESPACE}", f"ns={index}")
        for name in live_speed.names_of(valves)
        for signal in signals
    ]


@contextmanager
def _running(
    folder: Path, command: Sequence[str], url: str, nodes: Sequence[str]
) -> Iterator[tuple[int, Iterator[tuple[float, int, int]]]]:
    """Run a client; give its id and when it said what: notifications received, samples lost."""
    with subprocess.Popen(
        [*command, url],
        cwd=folder,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdin is not None and process.stdout is not None  # noqa: PT018, S101 - pipes
        given_up = threading.Timer(PATIENCE_S, process.kill)
        given_up.start()
        try:
            process.stdin.write("\n".join(nodes) + "\n")
            process.stdin.close()
            yield process.pid, _said(process.stdout, given_up)
        finally:
            given_up.cancel()
            process.kill()


def _said(lines: IO[str], given_up: threading.Timer) -> Iterator[tuple[float, int, int]]:
    for line in lines:
        received, lost = map(int, line.split())
        if received:
            given_up.cancel()
        yield time.perf_counter(), received, lost


def main(arguments: Sequence[str]) -> int:
    """Measure and print."""
    given = [float(x) for x in arguments]
    valves, hz, seconds = given + [1_000.0, 170.0, 30.0][len(given) :]
    for name, figure in measured(int(valves), hz, seconds).items():
        print(f"{name:36} {figure:14,.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
