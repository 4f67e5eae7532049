"""The page about speed: from a record of figures to bars, text and picture.

A record is what ``results/latest.json`` holds: machine, versions, when and with which command each
table was measured, and of each table its title, with name → value.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

Figures = Mapping[str, float]
Record = Mapping[str, Any]

REPLAY: Final = "Default configuration, replay from Parquet"
AUTO: Final = "Auto alone, samples/s of a core"
MEMORY: Final = "Default configuration, memory of a valve, kB"
RLS_LIVE: Final = "Live over TCP, RLS, no encryption"
SCALING: Final = "Time per sample, ns, 100,000 samples in a message"
START: Final = "Start, s"
FIRST_START: Final = "First start on a machine, s"
MANY: Final = "Start of 1,000 valves, default configuration, s"
SIZES: Final = "By the number of parameters, ns per update"
FLEETS: Final = (10, 100.0), (100, 100.0), (1_000, 10.0)  # valves, Hz: those that play live

ABOUT: Final = "machine", "versions", "measured", "bars", "ratios to ours"
PICTURE: Final = "performance.png"

_INTRODUCTION = f"""# Performance

Made by `make bench`; do not edit. What users run comes first, then the parts. Each table was
measured in one run, of all that it compares: compare within a table only. `python -m
benchmarks.speed PART…` measures some of them anew.

## What users run

The default configuration (RLS, RML, RBF and `Auto`), on one core: how many valves of which rate.

![Valves by rate: what a core carries, and what was carried live]({PICTURE})
"""


@dataclass(frozen=True)
class Bar:
    """A bar: the least or the largest value of a figure."""

    what: str
    unit: str
    bar: float
    figure: Callable[[Record], float]
    command: str
    at_most: bool = True


def live_title(valves: int, hz: float) -> str:
    """What the table of a fleet is called."""
    return f"Default configuration, live, {valves:,} valves of {hz:g} Hz"


def page(record: Record) -> str:
    """The page, all of it from the record."""
    lines = [_INTRODUCTION, *_users(record), *_bars(record)]
    lines += [f"Machine: {record['machine']}.", ""]
    versions = ", ".join(f"{name} {version}" for name, version in record["versions"].items())
    lines += [f"Versions: {versions}.", ""]
    for title, figures in record.items():
        if title not in ABOUT:
            lines += [f"## {title}", "", _origin(record, title), ""]
            lines += [*_table(figures, record["ratios to ours"].get(title)), ""]
    return "\n".join(lines).rstrip("\n") + "\n"


def bars(record: Record) -> list[dict[str, Any]]:
    """Every bar with its measured figure; None without one."""
    found = []
    for bar in BARS:
        try:
            value = bar.figure(record)
        except KeyError:
            value = None
        met = None if value is None else (value <= bar.bar if bar.at_most else value >= bar.bar)
        found.append(
            {
                "figure": bar.what,
                "value": value,
                "unit": bar.unit,
                "bar": bar.bar,
                "at most": bar.at_most,
                "met": met,
                "command": bar.command,
            }
        )
    return found


def draw(record: Record, file: Path) -> None:
    """Valves by rate: computed for one core, and measured live."""
    figure = Figure(figsize=(7.0, 4.5), layout="constrained")
    axes = figure.add_subplot(
        xscale="log", yscale="log", xlabel="valves", ylabel="samples per valve and second, Hz"
    )
    valves = np.array([1.0, 10_000.0])
    for label, speed in _capacities(record).items():
        axes.plot(valves, speed / valves, label=f"{label}: {speed:,.0f} samples/s of a core")
    for n, hz in FLEETS:
        figures = record.get(live_title(n, hz))
        if figures is not None:
            axes.plot([n], [hz], "o" if figures["lost"] == 0 else "x", color="black")
            note = f"live: {figures['cores of the service']:.2f} cores, {figures['lost']:,.0f} lost"
            axes.annotate(note, (n, hz), (6, 6), textcoords="offset points")
    axes.set(xlim=(1, 10_000), ylim=(1, 10_000))
    axes.grid(visible=True, which="major", alpha=0.3)
    if axes.get_lines():
        axes.legend(loc="lower left")
    figure.savefig(file, dpi=110, metadata={"Software": None})


def _capacities(record: Record) -> dict[str, float]:
    found = {}
    if REPLAY in record:
        found["default configuration, replay"] = record[REPLAY]["samples/s of a core"]
    if RLS_LIVE in record:
        figures = record[RLS_LIVE]
        reached = figures["reached, notifications/s"] / figures["cores of the service"]
        found["RLS alone, live"] = reached / 6  # signals of a sample, its running number included
    return found


def _users(record: Record) -> list[str]:
    head = "| how | valves | Hz | samples/s | lost | age when published, p99 | cores |"
    lines = [head, "|---" * 7 + "|"]
    if REPLAY in record:
        figures = record[REPLAY]
        speed = figures["samples/s of a core"]
        lines += [f"| replay from Parquet | {figures['valves']:,} | | {speed:,.0f} | | | 1 |"]
    for valves, hz in FLEETS:
        figures = record.get(live_title(valves, hz))
        row = f"| live | {valves:,} | {hz:g} | "
        if figures is None:
            lines += [f"{row}not measured | | | |"]
        else:
            age = f"{figures['age when published, p99, s']:.3g} s"
            cores = f"{figures['cores of the service']:.2f}"
            carried = f"{figures['samples/s']:,.0f} | {figures['lost']:,.0f}"
            lines += [f"{row}{carried} | {age} | {cores} |"]
    return [*lines, ""]


def _bars(record: Record) -> list[str]:
    lines = ["## Bars", "", "| figure | measured | bar | met | command |", "|---|---|---|---|---|"]
    for row in bars(record):
        unit = f" {row['unit']}" if row["unit"] else ""
        value = "not measured" if row["value"] is None else f"{_shown(row['value'])}{unit}"
        bar = f"{'≤' if row['at most'] else '≥'} {_shown(row['bar'])}{unit}"
        met = {True: "yes", False: "**no**", None: ""}[row["met"]]
        lines.append(f"| {row['figure']} | {value} | {bar} | {met} | `{row['command']}` |")
    return [*lines, ""]


def _origin(record: Record, title: str) -> str:
    found = record["measured"][title]
    return f"`{found['command']}`, {found['on']}."


def _table(figures: Figures, ratios: Figures | None) -> list[str]:
    """One row a figure; where all are called "who: what", one row a who."""
    if all(": " in name for name in figures):
        return _wide(figures)
    if ratios is None:
        lines = ["| what | figure |", "|---|---|"]
        return lines + [f"| {name} | {_shown(value)} |" for name, value in figures.items()]
    lines = ["| who | times ours | figure |", "|---|---|---|"]
    rows = ((name, ratios[name], _shown(value)) for name, value in figures.items())
    return lines + [f"| {name} | {ratio:.2f} | {value} |" for name, ratio, value in rows]


def _wide(figures: Figures) -> list[str]:
    parts = [name.split(": ", 1) for name in figures]
    rows, columns = (list(dict.fromkeys(part)) for part in zip(*parts, strict=True))
    lines = [f"| | {' | '.join(columns)} |", "|---" * (1 + len(columns)) + "|"]
    for row in rows:
        names = (f"{row}: {column}" for column in columns)
        cells = (_shown(figures[name]) if name in figures else "" for name in names)
        lines.append(f"| {row} | {' | '.join(cells)} |")
    return lines


def _shown(value: float) -> str:
    return f"{value:,.4g}" if abs(value) < 100 else f"{value:,.0f}"


def _live(valves: int, hz: float, name: str) -> Callable[[Record], float]:
    return lambda record: record[live_title(valves, hz)][name]


def _of_sizes(n: int) -> Bar:
    return Bar(
        f"RLS of n = {n} over C -O3 of the same algorithm",
        "×",
        2.0,
        lambda record: record[SIZES][f"n = {n}: ours over C"],
        "python -m benchmarks.kernel_speed",
    )


_DEFAULT, _MINUTES = "python -m benchmarks.default_speed", "--seconds 600"
BARS: Final = (
    Bar(
        "default configuration, replay from Parquet, 100 valves × 10,000 samples",
        "samples/s of a core",
        50_000.0,
        lambda record: record[REPLAY]["samples/s of a core"],
        f"{_DEFAULT} replay",
        at_most=False,
    ),
    Bar(
        "`Auto` alone, after the first 1,000 samples of each valve",
        "samples/s of a core",
        100_000.0,
        lambda record: min(v for name, v in record[AUTO].items() if name.endswith("after them")),
        "python -m benchmarks.auto_speed",
        at_most=False,
    ),
    *(
        Bar(
            f"live, default configuration, {valves:,} × {hz:g} Hz: {what}",
            unit,
            bar,
            _live(valves, hz, name),
            f"{_DEFAULT} live {_MINUTES}",
        )
        for valves, hz in FLEETS[1:]
        for what, unit, bar, name in (
            ("lost", "", 0.0, "lost"),
            ("results' age when published, p99", "s", 1.0, "age when published, p99, s"),
        )
    ),
    Bar(
        "memory of a valve, default configuration",
        "kB",
        100.0,
        lambda record: record[MEMORY]["resident"],
        f"{_DEFAULT} memory",
    ),
    Bar(
        "live, RLS, 1,020,000 notifications/s: lost",
        "",
        0.0,
        lambda record: record[RLS_LIVE]["lost"],
        "python -m benchmarks.live_speed",
    ),
    Bar(
        "live, RLS, 1,020,000 notifications/s",
        "cores",
        0.5,
        lambda record: record[RLS_LIVE]["cores of the service"],
        "python -m benchmarks.live_speed",
    ),
    Bar(
        "time per sample of 10,000 valves over that of 10, all of one age",
        "×",
        1.3,
        lambda record: record[SCALING]["10,000 valves"] / record[SCALING]["10 valves"],
        "python -m benchmarks.pipeline_speed",
    ),
    Bar(
        "results server of 1,000 valves, default configuration, serves after",
        "s",
        4.0,
        lambda record: record[MANY]["results served"],
        "python -m benchmarks.start_up many",
    ),
    Bar(
        "first compile, two cores",
        "s",
        30.0,
        lambda record: record[FIRST_START]["compiled"],
        "python -m benchmarks.start_up first",
    ),
    Bar(
        "warm start to the first result over that of a bare asyncua server",
        "×",
        1.1,
        lambda record: (
            record[START]["ours: first results published"] / record[START]["bare asyncua: listens"]
        ),
        "python -m benchmarks.start_up",
    ),
    *(_of_sizes(n) for n in (9, 20, 63)),
)
