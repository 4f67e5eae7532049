"""From sample to result at a client: ``python -m benchmarks.latency [HZ] [SECONDS]``.

One valve, publishing intervals of 1 ms on both ways; rig, service (this process) and client are
separate processes. The time is the machine's, from the sample's SourceTimestamp on.
"""

import asyncio
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks import live_speed
from guarded_opcua import Limits
from valvemap.app.build import build_identification
from valvemap.app.serve import serve
from valvemap.cli.logs import set_up_logs
from valvemap.config.logs import LogConfig
from valvemap.pipeline.identification import Identification
from valvemap.vocabulary.statuses import Quality

PUBLISHING_MS = 1.0
CLIENTS = "ours", "asyncua"


def measured(
    hz: float = 1_000.0,
    seconds: float = 20.0,
    *,
    known: bool = True,
    clients: Sequence[str] = CLIENTS,
) -> dict[str, float]:
    """Percentiles of the latency, ms, once the valve is ``known`` if so; losses."""
    set_up_logs(LogConfig(level="error"))
    with tempfile.TemporaryDirectory() as name:
        url = live_speed.free_url("rig")
        command = ["valvemap", "rig", "--under-demo", "--url", url, "--rate", str(hz)]
        command += ["--publishing-interval", str(PUBLISHING_MS)]
        with live_speed.running(command, {}):
            return asyncio.run(_measured(Path(name), url, seconds, known=known, clients=clients))


async def _measured(
    folder: Path, url: str, seconds: float, *, known: bool, clients: Sequence[str]
) -> dict[str, float]:
    config = live_speed.open_config(["Valvistor"], folder, url)
    quick = config.source.model_copy(update={"publishing_interval_ms": PUBLISHING_MS})
    config = config.model_copy(update={"source": quick})
    settings = live_speed.open_settings(config, Limits(publishing_interval_ms=PUBLISHING_MS))
    identification, stop = build_identification(config), asyncio.Event()
    serving = asyncio.ensure_future(serve(config, stop, settings, identification))
    try:
        while not serving.done() and not _is_ready(identification, known=known):  # noqa: ASYNC110 - a state
            await asyncio.sleep(0.5)
        figures = {}
        for whose in clients:
            arguments = (whose, config.server.url, str(PUBLISHING_MS), str(seconds))
            client = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "benchmarks.latency_client"),
                *arguments,
                stdout=subprocess.PIPE,
            )
            out, _ = await client.communicate()
            p50, p99, worst, count = (float(x) for x in out.split())
            figures |= {
                f"{whose}: results/s": count / seconds,
                f"{whose}: p50, ms": p50,
                f"{whose}: p99, ms": p99,
                f"{whose}: worst, ms": worst,
            }
        lost = sum(int(live_speed.counts(identification, n).sum()) for n in live_speed.LOSSES)
    finally:
        stop.set()
        await serving
    return {**figures, "lost": lost}


def _is_ready(identification: Identification, *, known: bool) -> bool:
    """Tell whether samples come, and the first half minute is over, in which no map is good yet."""
    if not known:
        return bool(live_speed.counts(identification, "aligned").min() > 0)
    return all(e.quality == Quality.GOOD for e in identification.results.one(0).estimators.values())


def main(arguments: list[str]) -> int:
    """Measure and print."""
    for name, value in measured(*(float(x) for x in arguments)).items():
        print(f"{name:20} {value:10.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
