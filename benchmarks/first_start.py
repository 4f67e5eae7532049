"""How long a clone takes to first results: ``python -m benchmarks.first_start [ROUNDS] [cold]``.

A fresh copy of the tree, without kernel cache and bytecode, compiles the kernels as
``make install`` does, unless ``cold``, and starts ``valvemap demo``. A client of asyncua's polls
the service until RLS, and then every estimator, has a sample behind its result. Samples are lost
if an estimator counts fewer than the service aligned, or the service reports a gap. At the end the
demo gets SIGTERM.
"""

import asyncio
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from asyncua import Client, ua

from benchmarks.live_speed import free_url
from valvemap.opcua_results.results_server import NAMESPACE

VALVE, ESTIMATORS = "Valvistor", ("RLS", "RML", "RBF", "Auto")
LOSSES = "Missing", "Gaps", "LostByTime"
PATIENCE_S, POLL_S = 300.0, 0.05
COPIED = "service", "virtual_rig", "config", "pyproject.toml"

Figures = dict[str, float]


def measured(*, cold: bool = False) -> Figures:
    """Seconds from the start of the demo, samples lost, and the exit code after SIGTERM."""
    with tempfile.TemporaryDirectory() as name:
        tree = copy_of_tree(Path(name))
        environment = environment_of(tree)
        of_install = time.perf_counter()
        if not cold:
            command = [sys.executable, "-m", "valvemap", "warm-up"]
            subprocess.run(command, cwd=tree, env=environment, check=True)
        of_install = time.perf_counter() - of_install
        return {"the install's kernels, s": of_install} | demo(tree, environment)


def demo(folder: Path, environment: dict[str, str]) -> Figures:
    """Seconds to the results of ``valvemap demo``, samples lost, exit code after SIGTERM."""
    url = free_url("service")
    urls = {"VALVEMAP_SOURCE__URL": free_url("rig"), "VALVEMAP_SERVER__URL": url}
    began = time.perf_counter()
    with subprocess.Popen(
        [sys.executable, "-m", "valvemap", "demo"],
        cwd=folder,
        env=environment | urls,
        stdout=subprocess.DEVNULL,
    ) as process:
        try:
            found = asyncio.run(watched(url, began))
        finally:
            process.send_signal(signal.SIGTERM)
        return found | {"exit code": process.wait()}


def copy_of_tree(folder: Path) -> Path:
    """Copy what git knows of the tree: no caches."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", *COPIED],
        check=True,
        capture_output=True,
        text=True,
    )
    for file in filter(None, listed.stdout.split("\0")):
        target = folder / file
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(Path(file).read_bytes())
    return folder


def environment_of(tree: Path) -> dict[str, str]:
    """Environment in which Python imports the copy, and numba caches beside its modules."""
    left_out = "NUMBA_CACHE_DIR", "PYTHONDONTWRITEBYTECODE", "PYTHONPYCACHEPREFIX"
    environment = {name: value for name, value in os.environ.items() if name not in left_out}
    paths = (str(tree / "service"), str(tree / "virtual_rig"))
    return environment | {"PYTHONPATH": os.pathsep.join(paths)}


async def watched(url: str, began: float) -> Figures:
    """Poll the results of a demo from the moment at which a client is admitted."""
    found: Figures = {}
    while time.perf_counter() - began < PATIENCE_S:
        try:
            async with Client(url, timeout=30) as client:
                await _poll(client, began, found)
                return found
        except (OSError, TimeoutError, ua.UaError):
            await asyncio.sleep(POLL_S)
    raise TimeoutError(f"no results of every estimator within {PATIENCE_S:g} s: {found}")


async def _poll(client: Client, began: float, found: Figures) -> None:
    index = await client.get_namespace_index(NAMESPACE)
    names = [f"{name}.SampleCount" for name in ESTIMATORS]
    names += [f"Diagnostics.{name}" for name in ("Aligned", *LOSSES)]
    ids = [ua.NodeId(f"{VALVE}.{name}", index) for name in names]
    waits = {name for name in ESTIMATORS if f"first result of {name}, s" not in found}
    while waits:
        read = await client.uaclient.read_attributes(ids, ua.AttributeIds.Value)
        values = [int(one.Value.Value or 0) for one in read]  # some are Uncertain, not yet Good
        counts, (aligned, *lost) = values[: len(ESTIMATORS)], values[len(ESTIMATORS) :]
        for name, count in zip(ESTIMATORS, counts, strict=True):
            if count and name in waits:
                waits.remove(name)
                found[f"first result of {name}, s"] = time.perf_counter() - began
        await asyncio.sleep(POLL_S)
    found["first result, s"] = min(found.values())
    found["all estimators, s"] = max(found.values())
    found["samples"] = aligned
    found["samples lost"] = sum(lost) + max(aligned - count for count in counts)


def main(arguments: list[str]) -> int:
    """Measure some times, and print every figure and the medians."""
    numbers = [int(one) for one in arguments if one != "cold"]
    rounds = [measured(cold="cold" in arguments) for _ in range(max([1, *numbers]))]
    for name in rounds[0]:
        values = [figures[name] for figures in rounds]
        each = " ".join(f"{value:8.1f}" for value in values)
        print(f"{name:28} median {statistics.median(values):8.1f}   of {each}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
