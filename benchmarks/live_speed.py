"""Live over TCP: a rig that plays a fleet, the service beside it, nothing lost.

``python -m benchmarks.live_speed [VALVES] [HZ] [SECONDS] [secured]``. Rig and service are
separate processes; the service (this process) runs RLS on every valve, publishes, keeps its
states, as always. With ``secured`` both are set up by ``valvemap init``: SignAndEncrypt.
"""

import asyncio
import importlib.util
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from guarded_opcua import Limits, ServerSettings
from valvemap.app.build import build_identification
from valvemap.app.identities import APPLICATION_NAME, APPLICATION_URI
from valvemap.app.serve import serve
from valvemap.cli.logs import set_up_logs
from valvemap.config.estimators import AnyEstimatorConfig, RlsConfig
from valvemap.config.loading import load_config
from valvemap.config.logs import LogConfig
from valvemap.config.models import Config
from valvemap.config.valves import NodesConfig, ValveConfig
from valvemap.pipeline.identification import Identification
from valvemap_rig.fleet import valve_names
from valvemap_rig.scenario import Fleet, Scenario

SIGNALS = 6  # five signals and the running number
SETTLING_S, PATIENCE_S = 5.0, 120.0
LOSSES = "missing", "gaps", "late", "duplicates"
SCRIPTED_VALVES, SCRIPTED_HZ = 50, 200.0

Figures = dict[str, float]


def measured(
    valves: int,
    hz: float,
    seconds: float = 60.0,
    *,
    settling_s: float = SETTLING_S,
    secured: bool = False,
) -> Figures:
    """Notifications per second that reach the parameters, losses, and the cores used."""
    set_up_logs(LogConfig(level="error"))
    with tempfile.TemporaryDirectory() as name:
        folder, url = Path(name), free_url("rig")
        environment = init(folder, url) if secured else {}
        with rig(valves, hz, url, environment):
            names = names_of(valves)
            if secured:
                loaded = load_config(folder / "data" / "service.toml")
                config = _with_valves(loaded, names, folder, {"url": url})
            else:
                config = open_config(names, folder, url)
            serving = live(config, hz, seconds, settling_s=settling_s, secured=secured)
            figures = asyncio.run(serving)
    return {"valves": valves, "wanted, notifications/s": valves * hz * SIGNALS, **figures}


def scripted(seconds: float = 10.0) -> Figures:
    """Notifications per second that plain scripts process; none without padasip."""
    if importlib.util.find_spec("padasip") is None:
        return {}
    names = ",".join(names_of(SCRIPTED_VALVES))
    figures, url = {}, free_url("rig")
    with running(["benchmarks.plain_server", url, names], {}):
        figures["asyncua's server, asyncua and padasip"] = _script(url, names, seconds)
    url = free_url("rig")
    with rig(SCRIPTED_VALVES, SCRIPTED_HZ, url, {}):
        figures["our rig, asyncua and padasip"] = _script(url, names, seconds)
    return figures


def main(arguments: list[str]) -> int:
    """Measure and print."""
    given = [float(x) for x in arguments if x != "secured"]
    valves, hz, seconds = given + [1000.0, 170.0, 60.0][len(given) :]
    figures = measured(int(valves), hz, seconds, secured="secured" in arguments)
    for name, value in figures.items():
        print(f"{name:26} {value:14,.3f}")
    return 0


async def live(
    config: Config, hz: float, seconds: float, *, settling_s: float = SETTLING_S, secured: bool
) -> Figures:
    """Serve for this time, once all valves have been learnt from."""
    identification, stop = build_identification(config), asyncio.Event()
    settings = None if secured else open_settings(config, Limits())
    serving = asyncio.ensure_future(serve(config, stop, settings, identification))
    given_up = time.perf_counter() + PATIENCE_S
    await _until(
        lambda: (
            serving.done()
            or time.perf_counter() >= given_up
            or counts(identification, "aligned").min() >= hz * settling_s
        )
    )
    before = counts(identification, "aligned")
    began, cpu = time.perf_counter(), time.process_time()
    await _until(lambda: serving.done() or time.perf_counter() - began >= seconds)
    took, cpu = time.perf_counter() - began, time.process_time() - cpu
    arrived = counts(identification, "aligned") - before
    lost = sum(int(counts(identification, name).sum()) for name in LOSSES)
    stop.set()
    await serving
    return {
        "reached, notifications/s": float(arrived.sum()) * SIGNALS / took,
        "lost": lost,
        "cores of the service": cpu / took,
    }


def _script(url: str, names: str, seconds: float) -> float:
    command = [sys.executable, "-m", "benchmarks.plain_script", url, names, str(seconds)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return float(done.stdout.split()[-1])


@contextmanager
def rig(valves: int, hz: float, url: str, environment: dict[str, str]) -> Iterator[None]:
    """Run a rig of this number of valves in a separate process."""
    command = ["valvemap", "rig", "--url", url, "--valves", str(valves), "--rate", str(hz)]
    with running(command if environment else [*command, "--under-demo"], environment):
        yield


@contextmanager
def running(module: list[str], environment: dict[str, str]) -> Iterator[int]:
    """Run a server in a separate process until it listens; return its id."""
    with subprocess.Popen(
        [sys.executable, "-m", *module],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=os.environ | environment,
    ) as process:
        assert process.stdin is not None and process.stdout is not None  # noqa: PT018, S101 - pipes
        try:
            process.stdin.write("password\n")
            process.stdin.flush()
            while "opc.tcp" not in (line := process.stdout.readline()):
                if not line:
                    raise RuntimeError(f"{module[0]} did not start")
            yield process.pid
        finally:
            process.kill()


def processor_time(pid: int) -> float:
    """Seconds of a core that another process has used, by Linux' `/proc`."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def init(folder: Path, url: str) -> dict[str, str]:
    """Certificates, users and configurations as a user makes them."""
    environment = {
        "VALVEMAP_OPERATOR_PASSWORD": "a password for a benchmark",
        "VALVEMAP_DATA": str(folder / "data"),
        "VALVEMAP_RIG_URL": url,
    }
    command = [sys.executable, "-m", "valvemap", "init"]
    subprocess.run(command, check=True, capture_output=True, env=os.environ | environment)
    return environment


def open_config(
    valves: Sequence[str],
    folder: Path,
    url: str,
    estimators: tuple[AnyEstimatorConfig, ...] = (RlsConfig(),),
) -> Config:
    """Estimators, RLS alone by default, on these valves of an open rig; states in the folder."""
    source = {"url": url, "security": "None"}
    return _with_valves(load_config(), valves, folder, source, estimators)


def open_settings(config: Config, limits: Limits) -> ServerSettings:
    """A results server without security."""
    return ServerSettings(
        url=config.server.url,
        application_uri=APPLICATION_URI,
        application_name=APPLICATION_NAME,
        namespace_uri=APPLICATION_URI,
        none_on_loopback=True,
        limits=limits,
    )


def counts(identification: Identification, name: str) -> np.ndarray:
    """A counter of every valve."""
    found = list(identification.results.of(range(len(identification.plans))))
    return np.concatenate([r.counters[:, r.counter_names.index(name)] for r in found])


def _with_valves(
    loaded: Config,
    valves: Sequence[str],
    folder: Path,
    source: dict[str, Any],
    estimators: tuple[AnyEstimatorConfig, ...] = (RlsConfig(),),
) -> Config:
    source |= {"startup_timeout_s": 60.0, "timeout_s": 60.0}
    return loaded.model_copy(
        update={
            "source": loaded.source.model_copy(update=source),
            "server": loaded.server.model_copy(update={"url": free_url("service")}),
            "state": loaded.state.model_copy(update={"file": folder / "state.sqlite"}),
            "valves": tuple(
                ValveConfig(name=n, nodes=NodesConfig.of_rig(n), estimators=estimators)
                for n in valves
            ),
        }
    )


def names_of(valves: int) -> tuple[str, ...]:
    """What the rig calls its valves."""
    return tuple(valve_names(Scenario(fleet=Fleet(valves=valves))))


async def _until(reached: Callable[[], bool]) -> None:
    while not reached():  # noqa: ASYNC110 - counts, not events
        await asyncio.sleep(0.5)


def free_url(name: str) -> str:
    """A port without a listener."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"opc.tcp://127.0.0.1:{free.getsockname()[1]}/valvemap/{name}/"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
