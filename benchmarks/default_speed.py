"""What users run: the default configuration, live and replayed, by valves and rate.

``python -m benchmarks.default_speed [SECONDS]`` measures each fleet for so long, and draws
``docs/performance.png``. Live is over TCP without encryption: a rig that plays the fleet, and the
service in this process, which learns with all estimators, publishes and keeps its states.
"""

import asyncio
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from benchmarks import auto_speed, live_speed
from service.cli.logs import set_up_logs
from service.config.estimators import default_estimators
from service.config.models import LogConfig
from service.opcua.results_server import ResultsServer
from service.streaming.ports import Results

PICTURE = Path(__file__).parents[1] / "docs" / "performance.png"
FLEETS: Final = (10, 100.0), (100, 100.0), (1_000, 10.0)  # valves, Hz
REPLAYED: Final = 100, 10_000  # valves, samples of each

_REPLAY: Final = "Default configuration, replay from Parquet"

Sections = Mapping[str, Mapping[str, float]]


def measured(seconds: float = 30.0) -> Sections:
    """Replay, and every fleet live."""
    found = {_REPLAY: replayed()}
    for valves, hz in FLEETS:
        found[_live(valves, hz)] = live(valves, hz, seconds)
    return found


def replayed() -> Mapping[str, float]:
    """Samples per second of one core."""
    valves, N = REPLAYED
    found = auto_speed.default_configuration(valves, N)
    return {"valves": valves, "samples of each": N, "samples/s of a core": found["replay"]}


def live(valves: int, hz: float, seconds: float) -> Mapping[str, float]:
    """What was lost, how old results were when they were published, and the cores used."""
    set_up_logs(LogConfig(level="error"))
    with tempfile.TemporaryDirectory() as name, _ages() as ages:
        url = live_speed.free_url("rig")
        with live_speed.rig(valves, hz, url, {}):
            names = live_speed.names_of(valves)
            config = live_speed.open_config(names, Path(name), url, default_estimators())
            figures = asyncio.run(live_speed.live(config, hz, seconds, secured=False))
        settled = ages[len(ages) // 3 :]
    return {
        "samples/s": figures["reached, notifications/s"] / live_speed.SIGNALS,
        "lost": figures["lost"],
        "results' age when published, p99, s": float(np.percentile(settled, 99)),
        "cores of the service": figures["cores of the service"],
    }


@contextmanager
def _ages() -> Iterator[list[float]]:
    """Ages of results in s, as they are published."""
    ages: list[float] = []
    publish = ResultsServer.publish

    async def noted(self: ResultsServer, results: Results) -> None:
        await publish(self, results)
        newest = np.max([found.t for found in results.estimators.values()], axis=0)
        ages.extend((time.time_ns() - newest[newest > 0]) / 1e9)

    ResultsServer.publish = noted  # type: ignore[method-assign]
    try:
        yield ages
    finally:
        ResultsServer.publish = publish  # type: ignore[method-assign]


def draw(found: Sections, rls: float | None = None) -> None:
    """Valves by rate: what a core carries, and what was carried live."""
    figure = Figure(figsize=(7.0, 4.5), layout="constrained")
    axes = figure.add_subplot(
        xscale="log", yscale="log", xlabel="valves", ylabel="samples per valve and second, Hz"
    )
    valves = np.array([1.0, 10_000.0])
    replay = found[_REPLAY]["samples/s of a core"]
    lines = {f"replay, a core: {replay:,.0f} samples/s": replay}
    if rls is not None:
        lines[f"RLS alone, live, a core: {rls:,.0f} samples/s"] = rls
    for label, speed in lines.items():
        axes.plot(valves, speed / valves, label=label)
    for n, hz in FLEETS:
        figures = found[_live(n, hz)]
        cores, lost = figures["cores of the service"], figures["lost"]
        axes.plot([n], [hz], "o" if lost == 0 else "x", color="black")
        axes.annotate(
            f"live: {cores:.2f} cores, {lost:,.0f} lost",
            (n, hz),
            (6, 6),
            textcoords="offset points",
        )
    axes.set(xlim=(1, 10_000), ylim=(1, 10_000))
    axes.grid(visible=True, which="major", alpha=0.3)
    axes.legend(loc="lower left")
    figure.savefig(PICTURE, dpi=110)


def _live(valves: int, hz: float) -> str:
    return f"Default configuration, live, {valves:,} valves of {hz:g} Hz"


def main(arguments: Sequence[str]) -> int:
    """Measure, draw and print."""
    found = measured(*(float(x) for x in arguments))
    draw(found)
    for title, figures in found.items():
        print(title)
        for name, figure in figures.items():
            print(f"  {name:40} {figure:14,.3f}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
