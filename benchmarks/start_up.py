"""How long the service takes from its first line to its first result: ``-m benchmarks.start_up``.

Rig and service are set up by ``valvemap init``; everything is compiled already. Beside it a bare
server of asyncua's, in turns, the best of some starts each.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks import live_speed

ROUNDS = 4
EVENTS = "results served", "source connected", "first results published"


def measured() -> dict[str, float]:
    """Seconds from the start of the process."""
    with tempfile.TemporaryDirectory() as name:
        url, folder = live_speed.free_url("rig"), Path(name)
        environment = live_speed.init(folder, url)
        environment |= {"VALVEMAP_SOURCE__URL": url}
        environment |= {"VALVEMAP_SERVER__URL": live_speed.free_url("service")}
        serve = ["service", "serve", "--config", str(folder / "data" / "service.toml")]
        figures: dict[str, list[float]] = {}
        with live_speed.running(["service", "rig", "--url", url], environment):
            for _ in range(ROUNDS + 1):  # the first one compiles, if nothing is compiled yet
                for line in EVENTS:
                    took = _until(serve, line, environment)
                    figures.setdefault(f"ours: {line}", []).append(took)
                bare = ["benchmarks.plain_start", live_speed.free_url("plain")]
                figures.setdefault("bare asyncua: listens", []).append(_until(bare, "opc", {}))
    return {name: min(times[1:]) for name, times in figures.items()}


def main() -> int:
    """Measure and print."""
    for name, seconds in measured().items():
        print(f"{name:24} {seconds:6.2f} s")
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
    sys.exit(main())
