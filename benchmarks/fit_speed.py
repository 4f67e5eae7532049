"""`fit` beside `replay`, and CSV beside Parquet: ratios of CPU time in one run.

``python -m benchmarks.fit_speed [--rows 2000000]`` writes one recording in both forms, and runs
each in turn; the figures stand in docs/notebooks.md. A run of few rows before them compiles.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import valvemap
from valvemap.model.samples import Samples
from valvemap.storage.recording_writer import RecordingWriter

BAR = 1.3
CHUNK = 100_000


def written(folder: Path, rows: int) -> None:
    """Write a recording of a valve, at 100 Hz, as r.csv and r.parquet."""
    rng = np.random.default_rng(0)
    for form in ("csv", "parquet"):
        with RecordingWriter(folder / f"r.{form}") as recording:
            for start in range(0, rows, CHUNK):
                n = min(CHUNK, rows - start)
                U, dp = rng.uniform(0, 100, n), rng.uniform(5, 200, n)
                Q = 0.1 * U * np.sqrt(dp) + 0.2 * rng.normal(size=n)
                t = 10_000_000 * np.arange(start, start + n)
                recording.append("V", Samples.of(t, U, 200 + 0 * dp, 200 - dp, Q))


def cpu_seconds(run: Callable[[Path], Any], file: Path) -> float:
    """Processor time of one run."""
    started = time.process_time()
    run(file)
    return time.process_time() - started


def main() -> None:
    """Print a row per run, and the ratios beside the bar."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--rows", type=int, default=2_000_000)
    rows = parser.parse_args().rows
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        written(folder, 2_000)
        valvemap.fit(folder / "r.csv")
        valvemap.fit(folder / "r.parquet")
        written(folder, rows)
        parquet = cpu_seconds(valvemap.replay, folder / "r.parquet")
        fit = cpu_seconds(valvemap.fit, folder / "r.parquet")
        csv = cpu_seconds(valvemap.fit, folder / "r.csv")
    print(f"| of {rows:,} rows, CPU time | ratio | bar |")
    print("|---|---|---|")
    print(f"| `fit` / `replay`, Parquet | {fit / parquet:.2f} | {BAR} |")
    print(f"| CSV / Parquet, `fit` | {csv / fit:.2f} | {BAR} |")


if __name__ == "__main__":
    main()
