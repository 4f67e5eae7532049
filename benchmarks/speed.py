"""How fast the service is: ``python -m benchmarks.speed [PART…] [--seconds S]``.

Measures all parts, or those that are named; keeps the others' earlier figures. Writes
``results/latest.json`` (figures, ratios to ours, bars), and of it ``docs/performance.md`` and its
picture; ``page`` as a part measures nothing. ``--seconds`` shortens the long live runs.
"""

import argparse
import json
import os
import platform
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from benchmarks import (
    alignment_speed,
    auto_speed,
    default_speed,
    foreign_clients,
    kernel_speed,
    latency,
    live_speed,
    peers,
    pipeline_speed,
    results_file,
    results_speed,
    speed_page,
    start_up,
)

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "benchmarks" / "results" / "latest.json"
PAGE = ROOT / "docs" / "performance.md"
LONG_S: Final = 600.0  # of the live runs whose bar is ten minutes

Sections = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class Part:
    """Tables that are measured together, and the command that measures these alone."""

    command: str
    measure: Callable[[float], Sections]
    compares: bool = False  # whether its tables are of ours, first, and others


def parts() -> Mapping[str, Part]:
    """All of them, in the order of the page; what users run first."""
    return {
        "default": Part("default_speed replay memory", lambda _: default_speed.measured()),
        "served": Part("default_speed live", default_speed.lived),
        "auto": Part("auto_speed", lambda _: auto_speed.measured()),
        "clients": Part(
            "foreign_clients",
            lambda _: {"Clients of the same fleet": foreign_clients.measured()},
        ),
        "kernels": Part("kernel_speed", lambda _: kernel_speed.compared(), compares=True),
        "sizes": Part("kernel_speed", lambda _: {speed_page.SIZES: kernel_speed.model_sizes()}),
        "pipeline": Part("pipeline_speed", lambda _: pipeline_speed.all_figures()),
        "live": Part("live_speed", lambda _: _live()),
        "alignment": Part(
            "alignment_speed", lambda _: {"Alignment, ns per change": alignment_speed.measured()}
        ),
        "results": Part(
            "results_speed", lambda _: {"Results to our client": results_speed.measured()}
        ),
        "latency": Part("latency", lambda _: {"One valve at 1,000 Hz": latency.measured()}),
        "start": Part("start_up", lambda _: start_up.all_figures()),
    }


def _live() -> Sections:
    return {
        speed_page.RLS_LIVE: live_speed.measured(1_000, 170.0),
        "Live over TCP, RLS, SignAndEncrypt": live_speed.measured(400, 170.0, secured=True),
        "Plain scripts, notifications/s": live_speed.scripted(),
    }


def measured(names: Sequence[str], seconds: float, before: Mapping[str, Any]) -> dict[str, Any]:
    """A record of these parts, and of the others' earlier figures."""
    all_parts = parts()
    tables = {title: before[title] for title in before if title not in speed_page.ABOUT}
    when: dict[str, Any] = dict(before.get("measured", {}))
    ratios: dict[str, Any] = dict(before.get("ratios to ours", {}))
    order: list[str] = []
    for name, part in all_parts.items():
        command = f"python -m benchmarks.{part.command}"
        if name in names:
            print(f"{name}: {command}", file=sys.stderr, flush=True)
            for title in [t for t, made in when.items() if made["part"] == name]:
                del tables[title], when[title]
                ratios.pop(title, None)
            for title, figures in part.measure(seconds).items():
                tables[title] = dict(figures)
                on = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
                when[title] = {"part": name, "command": command, "on": on}
                if part.compares:
                    ratios[title] = _ratios(figures)
        order += [title for title in tables if when[title]["part"] == name]
    return {
        "machine": _machine(),
        "versions": {name: version(name) for name in ("numpy", "numba", "asyncua")}
        | peers.installed()
        | foreign_clients.versions(),
        "measured": {title: when[title] for title in order},
        "ratios to ours": {title: ratios[title] for title in order if title in ratios},
        **{title: tables[title] for title in order},
    }


def _ratios(values: Mapping[str, float]) -> dict[str, float]:
    """How many times the first."""
    first = next(iter(values.values()))
    return {name: value / first for name, value in values.items()}


def _machine() -> str:
    return f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}"


def main(arguments: Sequence[str]) -> int:
    """Measure, write, print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.speed")
    parser.add_argument("part", nargs="*", help=", ".join([*parts(), "page"]))
    parser.add_argument("--seconds", type=float, default=LONG_S)
    asked = parser.parse_args(arguments)
    unknown = set(asked.part) - set(parts()) - {"page"}
    if unknown:
        parser.error(f"{', '.join(sorted(unknown))}: no such part")
    record = json.loads(RESULTS.read_text("utf-8")) if RESULTS.exists() else {}
    wanted = asked.part or list(parts())
    for name in (name for name in parts() if name in wanted):
        record = measured([name], asked.seconds, record)
        results_file.keep(RESULTS, record)  # what took long is not lost with a part that fails
    record = {**record, "bars": speed_page.bars(record)}
    results_file.keep(RESULTS, record)
    page = speed_page.page(record)
    PAGE.write_text(page, "utf-8")
    speed_page.draw(record, PAGE.with_name(speed_page.PICTURE))
    print(page)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
