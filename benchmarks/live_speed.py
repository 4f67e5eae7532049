"""Live over TCP: a rig that plays a fleet, the service beside it, nothing lost.

``python -m benchmarks.live_speed [VALVES] [HZ] [SECONDS]``. Rig and service are processes of their
own; the service (this process) runs RLS on every valve, publishes, keeps its states, as always.
"""

import asyncio
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from service.app.build import APPLICATION_NAME, APPLICATION_URI, build_identification
from service.app.serve import serve
from service.config.estimators import RlsConfig
from service.config.loading import load_config
from service.config.models import Config, NodesConfig, ValveConfig
from service.opcua.hardened import ServerSettings
from service.streaming.identification import Identification
from virtual_rig.fleet import valve_names
from virtual_rig.scenario import Fleet, Scenario

SIGNALS = 6  # five signals and the running number
SETTLING_S, PATIENCE_S = 5.0, 120.0


async def live(valves: int, hz: float, seconds: float, folder: Path) -> dict[str, float]:
    """Notifications per second that reach the parameters, what was lost, and the cores used."""
    config = _config(valves, folder)
    command = [sys.executable, "-m", "service", "rig", "--under-demo", "--url", config.source.url]
    command += ["--valves", str(valves), "--rate", str(hz)]
    rig = subprocess.Popen(  # noqa: ASYNC220 - nothing else runs yet
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        rig.stdin.write("password\n")
        rig.stdin.flush()
        await asyncio.to_thread(rig.stdout.readline)
        identification, stop = build_identification(config), asyncio.Event()
        settings = ServerSettings(
            url=config.server.url,
            application_uri=APPLICATION_URI,
            application_name=APPLICATION_NAME,
            namespace_uri=APPLICATION_URI,
            none_on_loopback=True,
        )
        serving = asyncio.ensure_future(serve(config, stop, settings, identification))
        given_up = time.perf_counter() + PATIENCE_S
        await _until(
            lambda: (
                serving.done()
                or time.perf_counter() >= given_up
                or _counts(identification, "aligned").min() >= hz * SETTLING_S
            )
        )
        before = _counts(identification, "aligned")
        began, cpu = time.perf_counter(), time.process_time()
        await _until(lambda: serving.done() or time.perf_counter() - began >= seconds)
        took, cpu = time.perf_counter() - began, time.process_time() - cpu
        arrived = _counts(identification, "aligned") - before
        lost = sum(
            int(_counts(identification, name).sum())
            for name in ("missing", "gaps", "late", "duplicates")
        )
        stop.set()
        await serving
    finally:
        rig.kill()
        rig.wait()
    return {
        "valves": valves,
        "wanted, notifications/s": valves * hz * SIGNALS,
        "reached, notifications/s": float(arrived.sum()) * SIGNALS / took,
        "lost": lost,
        "cores of the service": cpu / took,
    }


def measured(valves: int = 200, hz: float = 200.0, seconds: float = 60.0) -> dict[str, float]:
    """The same, with a loop and a folder of its own."""
    with tempfile.TemporaryDirectory() as folder:
        return asyncio.run(live(valves, hz, seconds, Path(folder)))


def main(arguments: list[str]) -> int:
    """Measure and print."""
    given = [float(x) for x in arguments] + [200.0, 200.0, 60.0][len(arguments) :]
    figures = measured(int(given[0]), *given[1:])
    for name, value in figures.items():
        print(f"{name:26} {value:14,.1f}")
    return 0


async def _until(reached: Callable[[], bool]) -> None:
    while not reached():  # noqa: ASYNC110 - counts, not events
        await asyncio.sleep(0.5)


def _config(valves: int, folder: Path) -> Config:
    loaded = load_config()
    names = valve_names(Scenario(fleet=Fleet(valves=valves)))
    estimators = (RlsConfig(),)
    source = {"url": _url("rig"), "security": "None", "startup_timeout_s": 60.0, "timeout_s": 60.0}
    return loaded.model_copy(
        update={
            "source": loaded.source.model_copy(update=source),
            "server": loaded.server.model_copy(update={"url": _url("service")}),
            "state": loaded.state.model_copy(update={"file": folder / "state.sqlite"}),
            "valves": tuple(
                ValveConfig(name=n, nodes=NodesConfig.of_rig(n), estimators=estimators)
                for n in names
            ),
        }
    )


def _counts(identification: Identification, name: str) -> np.ndarray:
    valves = range(len(identification.plans))
    return np.array([identification.counters(valve)[name] for valve in valves])


def _url(name: str) -> str:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"opc.tcp://127.0.0.1:{free.getsockname()[1]}/valvemap/{name}/"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
