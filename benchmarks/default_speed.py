"""The default configuration: replayed, live by valves and rate, and its memory.

``python -m benchmarks.default_speed [replay] [live] [memory] [--seconds S]``: all three, or the
named ones; each fleet is measured live for S s. Live is over TCP without encryption: a rig that
plays the fleet, and the service in this process, which learns with all estimators, publishes and
keeps its states.
"""

import argparse
import asyncio
import gc
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmarks import auto_speed, live_speed, pipeline_speed
from benchmarks.speed_page import FLEETS, MEMORY, REPLAY, live_title
from valvemap.app.build import build_identification
from valvemap.cli.logs import set_up_logs
from valvemap.config.estimators import default_estimators
from valvemap.config.loading import load_config
from valvemap.config.logs import LogConfig
from valvemap.config.models import Config
from valvemap.config.valves import NodesConfig, ValveConfig
from valvemap.opcua_results.results_server import ResultsServer
from valvemap.pipeline.results import Results

REPLAYED: Final = 100, 10_000  # valves, samples of each
SHORT_S: Final = 60.0
MEMORISED: Final = 100, 500  # valves: of these the difference is taken
MEMORISED_SAMPLES: Final = 2_000  # of each: 20 s of 100 Hz

Figures = Mapping[str, float]
Sections = Mapping[str, Figures]
Ages = NDArray[np.float32]


def measured() -> Sections:
    """Replay, memory."""
    return {REPLAY: replayed(), MEMORY: memory()}


def replayed() -> Figures:
    """Samples per second of one core."""
    valves, N = REPLAYED
    found = auto_speed.default_configuration(valves, N)
    return {"valves": valves, "samples of each": N, "samples/s of a core": found["replay"]}


def lived(seconds: float) -> Sections:
    """Every fleet live for this time; the first, which has no bar, for `SHORT_S` at most."""
    durations = [min(seconds, SHORT_S), *(seconds for _ in FLEETS[1:])]
    return {
        live_title(*fleet): live(*fleet, for_s)
        for fleet, for_s in zip(FLEETS, durations, strict=True)
    }


def live(valves: int, hz: float, seconds: float) -> Figures:
    """Losses, age of results when published, and the cores used."""
    set_up_logs(LogConfig(level="error"))
    with tempfile.TemporaryDirectory() as name, _ages() as ages:
        url = live_speed.free_url("rig")
        with live_speed.rig(valves, hz, url, {}):
            names = live_speed.names_of(valves)
            config = live_speed.open_config(names, Path(name), url, default_estimators())
            figures = asyncio.run(live_speed.live(config, hz, seconds, secured=False))
        settled = np.concatenate([age for when, age in ages if ages[-1][0] - when <= seconds])
    return {
        "seconds": seconds,
        "samples/s": figures["reached, notifications/s"] / live_speed.SIGNALS,
        "lost": figures["lost"],
        "age when published, p99, s": float(np.percentile(settled, 99)),
        "cores of the service": figures["cores of the service"],
    }


def memory() -> Figures:
    """Resident kB of a learnt valve, and the part of its estimators' arrays.

    In a separate process: what this one has freed would be taken again unseen.
    """
    with get_context("spawn").Pool(1) as pool:
        resident = pool.apply(_resident_of_a_valve)
    return {
        "resident": resident,
        **{f"arrays: {name}": size for name, size in auto_speed.memory().items()},
    }


def _resident_of_a_valve() -> float:
    few, many = MEMORISED
    kept, sizes = [], []
    for valves in (few, few, many):  # the first pays for all that is loaded on its way
        gc.collect()
        before = pipeline_speed.resident()
        identification = build_identification(_fleet(valves))
        for valve in range(valves):
            samples = auto_speed.recording("cycle", valve, MEMORISED_SAMPLES)
            for start in range(0, MEMORISED_SAMPLES, auto_speed.BATCH):
                identification.take_samples(valve, samples[start : start + auto_speed.BATCH])
        gc.collect()
        sizes.append(pipeline_speed.resident() - before)
        kept.append(identification)
    return (sizes[2] - sizes[1]) / (many - few)


def _fleet(valves: int) -> Config:
    names = [f"V{k}" for k in range(valves)]
    made = tuple(ValveConfig(name=name, nodes=NodesConfig.of_rig(name)) for name in names)
    return load_config().model_copy(update={"valves": made})


@contextmanager
def _ages() -> Iterator[list[tuple[float, Ages]]]:
    """When results were published, by a clock in s, and how old in s: the oldest of each valve."""
    ages: list[tuple[float, Ages]] = []
    publish = ResultsServer.publish

    async def noted(self: ResultsServer, results: Results) -> None:
        await publish(self, results)
        now = time.time_ns()
        oldest = np.min([found.t for found in results.estimators.values()], axis=0)
        ages.append((now / 1e9, ((now - oldest[oldest > 0]) / 1e9).astype(np.float32)))

    ResultsServer.publish = noted  # type: ignore[method-assign]
    try:
        yield ages
    finally:
        ResultsServer.publish = publish  # type: ignore[method-assign]


def main(arguments: Sequence[str]) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.default_speed")
    parts = {
        "replay": lambda _: {REPLAY: replayed()},
        "live": lived,
        "memory": lambda _: {MEMORY: memory()},
    }
    parser.add_argument("part", nargs="*", help=", ".join(parts))
    parser.add_argument("--seconds", type=float, default=30.0)
    asked = parser.parse_args(arguments)
    unknown = set(asked.part) - set(parts)
    if unknown:
        parser.error(f"{', '.join(sorted(unknown))}: no such part")
    for part in asked.part or parts:
        for title, figures in parts[part](asked.seconds).items():
            print(title)
            for name, figure in figures.items():
                print(f"  {name:40} {figure:14,.3f}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
