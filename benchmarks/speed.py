"""How fast the service is, in one run: ``python -m benchmarks.speed``.

Writes ``results/latest.json`` (figures and ratios) and ``docs/performance.md``. Ratios come first:
absolute figures say more of the machine than of us.
"""

import json
import os
import platform
import sys
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

from benchmarks import (
    alignment_speed,
    auto_speed,
    default_speed,
    kernel_speed,
    latency,
    live_speed,
    peers,
    pipeline_speed,
    results_speed,
    start_up,
)
from service.identification.forgetting import Adaptive, Exponential

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "benchmarks" / "results" / "latest.json"
PAGE = ROOT / "docs" / "performance.md"

Sections = Mapping[str, Mapping[str, float]]

PICTURE = "![Valves by rate: what a core carries, and what was carried live](performance.png)"
INTRODUCTION = """# Performance

Made by `make bench`; do not edit. Figures of a busy machine: compare within a table only.
"""


def main() -> int:
    """Measure, print, write."""
    default = {**default_speed.measured(), "Memory of a valve, kB": auto_speed.memory()}
    lam = kernel_speed.LAM
    compared = {
        "One model, n = 5, ns per update": kernel_speed.one_model(),
        "Estimators as the service runs them, ns per sample": kernel_speed.whole_estimators(),
        "By the number of parameters, default forgetting, ns": kernel_speed.model_sizes(),
        "10,000 models, default forgetting, ns": kernel_speed.many_models(Adaptive(lam)),
        "10,000 models, exponential, ns": kernel_speed.many_models(Exponential(lam)),
    }
    figures = pipeline_speed.all_figures() | {
        "Live over TCP, no encryption": live_speed.measured(1_000, 170.0),
        "Live over TCP, SignAndEncrypt": live_speed.measured(400, 170.0, secured=True),
        "Plain scripts, notifications/s": live_speed.scripted(),
        "Alignment, ns per change": alignment_speed.measured(),
        "Results to our client": results_speed.measured(),
        "One valve at 1,000 Hz": latency.measured(),
        "Start, s": start_up.measured(),
        "Start of 1,000 valves, default configuration, s": start_up.many(),
    }
    rls = figures["Live over TCP, no encryption"]
    of_a_core = rls["reached, notifications/s"] / rls["cores of the service"]
    default_speed.draw(default, of_a_core / live_speed.SIGNALS)
    versions = {name: version(name) for name in ("numpy", "numba", "asyncua")} | peers.installed()
    record = {
        "machine": _machine(),
        "versions": versions,
        "ratios to ours": {title: _ratios(values) for title, values in compared.items()},
        **default,
        **compared,
        **figures,
    }
    RESULTS.parent.mkdir(parents=True, exist_ok=True)
    RESULTS.write_text(json.dumps(record, indent=2, ensure_ascii=False) + "\n", "utf-8")
    page = _page(default, compared, figures, versions)
    PAGE.write_text(page, "utf-8")
    print(page)
    return 0


def _ratios(values: Mapping[str, float]) -> dict[str, float]:
    """How many times the first."""
    first = next(iter(values.values()))
    return {name: value / first for name, value in values.items()}


def _page(
    default: Sections, compared: Sections, figures: Sections, versions: dict[str, str]
) -> str:
    """What users run comes first, then the parts."""
    lines = [INTRODUCTION, f"Machine: {_machine()}.", ""]
    lines += ["Versions: " + ", ".join(f"{n} {v}" for n, v in versions.items()) + ".", ""]
    lines += [*_tables(default), PICTURE, ""]
    for title, values in compared.items():
        ratios = _ratios(values)
        lines += [f"## {title}", "", "| who | times ours | ns |", "|---|---|---|"]
        lines += [f"| {n} | {ratios[n]:.2f} | {v:,.0f} |" for n, v in values.items()] + [""]
    lines += _tables(figures)
    return "\n".join(lines).rstrip("\n") + "\n"


def _tables(sections: Sections) -> list[str]:
    lines = []
    for title, values in sections.items():
        lines += [f"## {title}", "", "| what | figure |", "|---|---|"]
        lines += [
            f"| {n} | {v:,.4g} |" if v < 100 else f"| {n} | {v:,.0f} |" for n, v in values.items()
        ]
        lines += [""]
    return lines


def _machine() -> str:
    return f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}"


if __name__ == "__main__":
    sys.exit(main())
