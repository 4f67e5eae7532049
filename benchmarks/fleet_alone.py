"""Speed of a fleet without a broker: ``python -m benchmarks.fleet_alone [PART ...]``.

Parts: ``worker``, where a worker's time goes, in processor time of one core, with RLS, with three
and with the default estimators: what a bare client (:mod:`benchmarks.fleet_speed`) cannot save,
since it does the same. ``reidentify [N]``: recordings of N samples in all, learnt again by one
process and by two, bar 1.6 x.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.fleet import Dictionary, block
from support.plant import plant
from valvemap.kafka.blocks import read_samples, write_samples
from valvemap.kafka.catalogue import load_catalogue
from valvemap.kafka.group import Group, Rhythm
from valvemap.kafka.result_blocks import write_results
from valvemap.kafka.settings import load_fleet
from valvemap.kafka.worker import Worker
from valvemap.storage.recording_writer import RecordingWriter

KINDS = {"rls": ("RLS",), "three": ("RLS", "RML", "RBF"), "default": ("RLS", "RML", "RBF", "Auto")}
VALVES, SAMPLES, WARM, BLOCKS = 50, 20, 10, 50  # a block is 1,000 samples
COMMIT = 10  # blocks of a group between commits
FILES, VALVES_OF_FILE = 8, 4
BAR = 1.6


def worker(kinds: tuple[str, ...]) -> dict[str, float]:
    """Processor time for a block of 1,000 samples, ms."""
    with tempfile.TemporaryDirectory() as name:
        estimators = "".join(f"[[valves.estimators]]\nkind = '{one}'\n" for one in kinds)
        site = "".join(f"[[valves]]\nname = 'V{k}'\n{estimators}" for k in range(VALVES))
        Path(name, "site.toml").write_text(site, encoding="utf-8")
        Path(name, "fleet.toml").write_text("[catalogue]\nsites = {s = 'site.toml'}\n")
        known = load_catalogue(load_fleet(Path(name, "fleet.toml")).catalogue)
    (plan,) = known.groups.values()
    messages = [
        write_samples(block(plan, n, [SAMPLES] * VALVES, seed=n % 16, first=n * SAMPLES))
        for n in range(1, WARM + BLOCKS + 1)
    ]
    group, whole, store = Group(plan, 1, Rhythm()), Worker(known, Rhythm()), Dictionary()
    key, found = plan.name.encode(), dict.fromkeys(("read", "learn", "results", "pack", "all"), 0.0)
    for k, message in enumerate(messages):
        took = {}
        took["read"], one = _timed(lambda m=message: read_samples(m))
        took["learn"], out = _timed(lambda b=one: list(group.take(b)))
        took["results"], _ = _timed(lambda o=out: [write_results(each) for each in o])
        took["pack"], _ = _timed(group.to_bytes)
        took["all"], _ = _timed(lambda m=message: whole.samples(key, m, store))
        if k % COMMIT == 0:
            took["all"] += _timed(whole.keep)[0]
        if k >= WARM:
            found = {name: found[name] + s * 1e3 / BLOCKS for name, s in took.items()}
    found["samples/s per core, engine and broker left out"] = 1e6 / found["all"]
    return found


def reidentify(samples: int) -> dict[str, float]:
    """Seconds of one process and of two, and their ratio; starting up is in both."""
    with tempfile.TemporaryDirectory() as name:
        folder, n = Path(name), samples // (FILES * VALVES_OF_FILE)
        valves = [[f"V{file}{k}" for k in range(VALVES_OF_FILE)] for file in range(FILES)]
        files = [folder / f"{file}.parquet" for file in range(FILES)]
        for file, names in zip(files, valves, strict=True):
            with RecordingWriter(file) as recording:
                for k, valve in enumerate(names):
                    recording.append(valve, plant(n, seed=k))
        config = folder / "site.toml"
        config.write_text(
            "".join(
                f"[[valves]]\nname = '{valve}'\n[[valves.estimators]]\nkind = 'RLS'\n"
                for names in valves
                for valve in names
            ),
            encoding="utf-8",
        )
        took = {p: _reidentified(folder, config, files, p) for p in (1, 2)}
    return {
        "one process, s": took[1],
        "two processes, s": took[2],
        f"ratio (bar {BAR})": took[1] / took[2],
        "samples/s, two processes": samples / took[2],
    }


def _reidentified(folder: Path, config: Path, files: list[Path], processes: int) -> float:
    out = folder / f"models{processes}"
    command = [sys.executable, "-m", "valvemap", "fleet", "reidentify", *files, "-c", config]
    one_thread = {"NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    began = time.monotonic()
    subprocess.run(
        [*command, "--out", out, "--processes", str(processes)],
        check=True,
        env={**os.environ, **one_thread},
    )
    return time.monotonic() - began


def _timed(what: Callable[[], Any]) -> tuple[float, Any]:
    began = time.process_time()
    out = what()
    return time.process_time() - began, out


def main(arguments: list[str]) -> int:
    """Measure and print."""
    numbers = [int(x) for x in arguments if x.isdecimal()]
    parts = [x for x in arguments if not x.isdecimal()] or ["worker", "reidentify"]
    for part in parts:
        if part == "reidentify":
            _show(part, reidentify(numbers[0] if numbers else 40_000_000))
            continue
        for kind, kinds in KINDS.items():
            _show(f"{part}, {kind}: ms for a block of 1,000 samples", worker(kinds))
    return 0


def _show(part: str, found: dict[str, float]) -> None:
    print(part)
    for name, value in found.items():
        print(f"  {name:50} {value:14,.2f}", flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
