"""What the history needs on disk and in CPU time: ``-m benchmarks.history_size [PART ...]``.

Parts: ``hour``, valves at 10 Hz saved once a second, as the service does; ``week``, seven days of
one valve, and what a client's trend of them costs. Signals are the virtual rig's; results vary as
those of estimators do. Without any part, all.
"""

import asyncio
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from guarded_opcua.address_space.declarations import Variable
from guarded_opcua.history.aggregate_kinds import Aggregate
from guarded_opcua.history.intervals import Rules
from guarded_opcua.history.processing import Processed, Summarised, aggregated
from valvemap.opcua_results.past import ResultsPast
from valvemap.pipeline.store_ports import Piece
from valvemap.storage.history import HistoryFile
from valvemap.storage.recordings import read_recording
from valvemap.vocabulary.signals import PUBLISHED

HZ, S = 10, 10**9
VALVES, HOUR, DAY, WEEK = 20, 3_600, 86_400, 7 * 86_400
HOUR_VALVES = 4  # of which the hour is measured, scaled to 20
RECORDED_S = 1_800.0
ESTIMATORS = "RLS", "RML", "RBF", "Auto"
BUCKETS = 1_008  # of 10 min
START = 1_700_000_100 * S

Figures = dict[str, float]
Columns = dict[str, NDArray[np.float64]]


def recorded(folder: Path) -> Path:
    """Half an hour of the virtual rig at 100 Hz."""
    file = folder / "rig.csv"
    rig = [sys.executable, "-m", "valvemap", "rig", "--scenario", "demo", "--offline"]
    how = ["--duration", f"{RECORDED_S:g}", "--record", str(file)]
    subprocess.run([*rig, *how], check=True, stdout=subprocess.DEVNULL)
    return file


def series(recording: Path, shift: int, n: int) -> dict[str, Columns]:
    """Signals and results of a valve: n samples at 10 Hz from a recording at 100 Hz, repeated."""
    with read_recording(recording) as parts:
        samples = [part for _, part in parts]
    whole = {name: np.concatenate([getattr(s, name) for s in samples]) for name in PUBLISHED}
    signals = {name: np.resize(np.roll(x, shift)[:: 100 // HZ], n) for name, x in whole.items()}
    rng = np.random.default_rng(shift)
    found = {"Signals": signals}
    for k, name in enumerate(ESTIMATORS):
        predicted = signals["Q"] + rng.normal(0.0, 0.5 + k, n)
        residual = signals["Q"] - predicted
        spread = np.sqrt(np.convolve(residual**2, np.full(100, 0.01))[:n])
        found[name] = {
            "PredictedFlow": predicted,
            "Residual": residual,
            "ResidualRmse": spread,
            "NoiseStd": spread * (1.0 + 0.01 * np.cumsum(rng.normal(0.0, 0.01, n))),
        }
    found["Inverse"] = {"RequiredU": np.full(n, np.nan)}
    return found


def pieces(name: str, of: dict[str, Columns], first: int, last: int) -> Iterator[Piece]:
    """One piece of each series, of samples from ``first`` to before ``last``."""
    for part, columns in of.items():
        n = len(next(iter(columns.values())))
        k = np.arange(first, last)
        values = {column: array[k % n] for column, array in columns.items()}
        t = START + k * (S // HZ)
        yield Piece(f"{name}.{part}", t, np.zeros(len(t), np.uint32), values)


def hour() -> Figures:
    """Bytes and CPU seconds of an hour, saved once a second."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rig = recorded(folder)
        plant = {f"V{k}": series(rig, 1_000 * k, HOUR * HZ) for k in range(HOUR_VALVES)}
        spent = 0.0
        with HistoryFile(folder / "h") as store:
            for second in range(HOUR):
                given = [
                    piece
                    for valve, of in plant.items()
                    for piece in pieces(valve, of, second * HZ, (second + 1) * HZ)
                ]
                began = time.process_time()
                store.save(given)
                spent += time.process_time() - began
            by_kind = _by_kind(store)
            size = store.size
    scale = VALVES / HOUR_VALVES
    return {
        "CPU s per hour of 20 valves": spent * scale,
        "% of a core": 100.0 * spent * scale / HOUR,
        "MB per day of 20 valves, all": size * scale * DAY / HOUR / 1e6,
        **{f"of it {kind}": scale * part * DAY / HOUR / 1e6 for kind, part in by_kind.items()},
    }


def _by_kind(store: HistoryFile) -> Figures:
    """Bytes of columns, by their kind."""
    rows = store._database.writer.execute(  # noqa: SLF001
        "SELECT name.name, sum(length(data)) FROM block JOIN part ON part.block = block.id "
        "JOIN name ON name.id = block.series GROUP BY name.name"
    ).fetchall()
    found = {"signals": 0.0, "results": 0.0, "tier of 10 s": 0.0, "tier of 5 min": 0.0}
    for name, size in rows:
        _, _, tier = name.partition("#")
        kind = "signals" if ".Signals" in name else "results"
        found[{"10s": "tier of 10 s", "300s": "tier of 5 min"}.get(tier, kind)] += size
    return found


def week() -> Figures:
    """Bytes of seven days of a valve, scaled to 20; CPU seconds of a trend of six signals."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        of = series(recorded(folder), 0, int(RECORDED_S) * HZ)
        began = time.process_time()
        with HistoryFile(folder / "h") as store:
            for first in range(0, WEEK * HZ, 5_000):
                store.save(pieces("V", of, first, min(first + 5_000, WEEK * HZ)))
            spent = time.process_time() - began
            by_kind, size = _by_kind(store), store.size
            trends = asyncio.run(_trends(store))
    return {
        "CPU s to save them": spent,
        "MB of 20 valves, all": VALVES * size / 1e6,
        **{f"of it {kind}": VALVES * part / 1e6 for kind, part in by_kind.items()},
        **trends,
    }


async def _trends(store: HistoryFile) -> Figures:
    past, found = ResultsPast(store), dict[str, float]()
    spans = {
        "7 days, 10 min": (WEEK, 600),
        "7 days, 610 s": (WEEK, 610),
        "1 day, 90 s": (DAY, 90),
        "1 hour, 3.6 s (raw)": (HOUR, 3.6),
    }
    for name, (length, width) in spans.items():
        end = START + WEEK * S - (START + WEEK * S) % (300 * S)
        for times in ("", ", again"):
            began = time.process_time()
            for signal in PUBLISHED:
                for kind in (Aggregate.MINIMUM, Aggregate.AVERAGE, Aggregate.MAXIMUM):
                    await _trend(past, signal, kind, (end - length * S, end), round(width * S))
            found[f"CPU s: 6 signals, min, mean, max, {name}{times}"] = time.process_time() - began
    return found


async def _trend(
    past: ResultsPast, signal: str, kind: Aggregate, span: tuple[int, int], width: int
) -> None:
    node = ua.NodeId(f"V.Signals.{signal}", 2)

    async def raw(*asked: Any) -> Any:
        return await past.raw(node, *asked)

    async def cells(low: int, high: int, width: int) -> Any:
        return await past.cells(node, low, high, width)

    summarised = Summarised(past.widths, cells)
    asked = Processed(node, kind, Rules(), *span, width)
    variable = Variable(node, ua.VariantType.Double)
    await aggregated(asked, variable, raw, 20_000, summarised)


PARTS = {"hour": hour, "week": week}


def main(arguments: Sequence[str]) -> int:
    """Measure and print."""
    for part in arguments or PARTS:
        print(part)
        for name, value in PARTS[part]().items():
            print(f"  {name:58} {value:12,.3f}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
