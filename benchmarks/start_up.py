"""How long the service takes from its first line to its first result: ``-m benchmarks.start_up``.

Rig and service are set up by ``valvemap init``; everything is compiled already. Beside it a bare
server of asyncua's, in turns, the best of some starts each. Then a service of a thousand valves in
the default configuration, until it serves, until a client has read a number of a few valves, and
until it has read one of every valve. And the first start on a machine, which compiles everything.
``many`` or ``first`` measure these alone.
"""

import asyncio
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import urlparse

from asyncua import Client, ua

from benchmarks import live_speed
from benchmarks.speed_page import FIRST_START, MANY, START
from guarded_opcua import Limits
from valvemap.app.serve import serve
from valvemap.cli.logs import set_up_logs
from valvemap.config.loading import load_config
from valvemap.config.logs import LogConfig
from valvemap.opcua_results.results_server import NAMESPACE

ROUNDS = 8
READ_AT_ONCE = 20  # valves
EVENTS = "results served", "source connected", "first results published"


def measured() -> dict[str, float]:
    """Seconds from the start of the process."""
    with tempfile.TemporaryDirectory() as name:
        url, folder = live_speed.free_url("rig"), Path(name)
        environment = live_speed.init(folder, url)
        environment |= {"VALVEMAP_SOURCE__URL": url}
        environment |= {"VALVEMAP_SERVER__URL": live_speed.free_url("service")}
        serve = ["valvemap", "serve", "--config", str(folder / "data" / "service.toml")]
        figures: dict[str, list[float]] = {}
        with live_speed.running(["valvemap", "rig", "--url", url], environment):
            for _ in range(ROUNDS + 1):  # the first one compiles, if nothing is compiled yet
                for line in EVENTS:
                    took = _until(serve, line, environment)
                    figures.setdefault(f"ours: {line}", []).append(took)
                bare = ["benchmarks.plain_start", live_speed.free_url("plain")]
                figures.setdefault("bare asyncua: listens", []).append(_until(bare, "opc", {}))
    return {name: min(times[1:]) for name, times in figures.items()}


def many(valves: int = 1_000) -> dict[str, float]:
    """Seconds from the start of the process of a service of many valves, all estimators each."""
    with tempfile.TemporaryDirectory() as name:
        folder, url = Path(name), live_speed.free_url("service")
        names = [f"V{k}" for k in range(valves)]
        sections = "".join(f'[[valves]]\nname = "{name}"\n' for name in names)
        file = folder / "service.toml"
        file.write_text(
            f'[source]\nurl = "{live_speed.free_url("nobody")}"\nsecurity = "None"\n'
            "startup_timeout_s = 600.0\n"
            f'[server]\nurl = "{url}"\n[state]\nfile = "{folder / "state.sqlite"}"\n{sections}'
        )
        began = time.perf_counter()
        with live_speed.running(["benchmarks.start_up", "serve", str(file)], {}) as pid:
            found = {"results served": time.perf_counter() - began}
            found["results served, s of a core"] = live_speed.processor_time(pid)
            return found | asyncio.run(_read(url, names, began))


def first() -> dict[str, float]:
    """Seconds until everything is compiled, into an empty cache, and those of a core it took."""
    before = os.times()
    with tempfile.TemporaryDirectory() as cache:
        began = time.perf_counter()
        command = [sys.executable, "-m", "valvemap", "warm-up"]
        environment = os.environ | {"NUMBA_CACHE_DIR": cache}
        subprocess.run(command, check=True, capture_output=True, env=environment)
        compiled, after = time.perf_counter() - began, os.times()
    spent = after.children_user + after.children_system
    spent -= before.children_user + before.children_system
    return {"compiled": compiled, "compiled, s of a core": spent}


def all_figures() -> dict[str, dict[str, float]]:
    """Every figure of this file."""
    return {START: measured(), MANY: many(), FIRST_START: first()}


async def _read(url: str, names: Sequence[str], began: float) -> dict[str, float]:
    """Seconds until a client has read one valve, and every one."""
    found = {}
    async with Client(url, timeout=120) as client:
        index = await client.get_namespace_index(NAMESPACE)
        nodes = [client.get_node(ua.NodeId(f"{name}.RLS.Residual", index)) for name in names]
        ids = [node.nodeid for node in nodes]
        for first in range(0, len(ids), READ_AT_ONCE):
            chosen = ids[first : first + READ_AT_ONCE]
            await client.uaclient.read_attributes(chosen, ua.AttributeIds.Value)
            found.setdefault(f"{READ_AT_ONCE} valves read", time.perf_counter() - began)
        found["every valve read"] = time.perf_counter() - began
    return found


async def _serve(file: Path) -> None:
    """Serve as ``valvemap serve`` does, with an open endpoint; say when it listens."""
    set_up_logs(LogConfig(level="error"))
    config = load_config(file)
    settings = live_speed.open_settings(config, Limits())
    serving = asyncio.ensure_future(serve(config, asyncio.Event(), settings))
    parsed = urlparse(settings.url)
    while not serving.done():
        try:
            _, writer = await asyncio.open_connection(parsed.hostname, parsed.port)
        except OSError:
            await asyncio.sleep(0.01)
        else:
            writer.close()
            print(settings.url, flush=True)
            break
    await serving


def main(arguments: Sequence[str]) -> int:
    """Measure and print, or run the server."""
    if arguments[:1] == ["serve"]:
        asyncio.run(_serve(Path(arguments[1])))
        return 0
    match arguments:
        case ["many"]:
            found = {MANY: many()}
        case ["first"]:
            found = {FIRST_START: first()}
        case _:
            found = all_figures()
    for title, figures in found.items():
        print(title)
        for name, seconds in figures.items():
            print(f"  {name:32} {seconds:6.2f} s")
    return 0


def _until(module: Sequence[str], word: str, environment: dict[str, str]) -> float:
    began = time.perf_counter()
    with subprocess.Popen(
        [sys.executable, "-u", "-m", *module],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=os.environ | environment,
    ) as process:
        assert process.stdout is not None  # noqa: S101 - a pipe
        for line in process.stdout:
            if word in line:
                break
        took = time.perf_counter() - began
        process.terminate()
        process.communicate()
    return took


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
