"""Every row about errors that a map states of itself: ``python -m benchmarks.honest_maps``.

``--seeds N`` measures that many seeds of each cell at most, ``--only WORD`` the cells whose name
holds the word; ``--first K`` begins at another seed than the page does. Figures are kept seed by
seed in benchmarks/results/honest_maps.json and not measured again as long as
``service/valvemap/model`` stays as it is; docs/honest_maps.md is written from it after each cell.
"""

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from benchmarks import (
    changes,
    coverage,
    lag,
    measured_data,
    outside,
    plants,
    results_file,
    tracking,
)
from benchmarks.cells import Cell, Figures, Judged
from benchmarks.recordings import one_step_ahead
from valvemap.model.forgetting import Adaptive

HERE: Final = Path(__file__).parent
RESULTS: Final = HERE / "results" / "honest_maps.json"
PAGE: Final = HERE.parent / "docs" / "honest_maps.md"
CORE: Final = HERE.parent / "service" / "valvemap" / "model"
FIRST: Final = 7_000  # seed: tests use smaller ones
CIRCUIT: Final = {
    "default": (Adaptive(), 0.9985),
    "named choice": (Adaptive(0.99), 0.9994),
}
FEED_FORWARD: Final = {
    "stale data": "test_stale_data_lead_to_the_fallback",
    "Bad quality": "test_bad_quality_leads_to_the_fallback",
    "extrapolated": "test_an_extrapolated_answer_leads_to_the_fallback",
    "above reach": "test_a_demand_above_reach_leads_to_the_fallback",
    "rejected write": "test_a_refused_write_is_repeated_then_the_rig_has_its_valve_back",
    "service killed": "test_a_killed_service_leaves_the_valve_to_the_rig_and_a_new_one_is_disarmed",
}
SECTIONS: Final = {
    "Misfit, drift, wear": tracking.cells(),
    "Lags": lag.cells(),
    "True flow covered by the 95 % interval, inside": coverage.cells(),
    "Plants with sensors that are off": plants.cells(),
    "Outside the data": outside.cells(),
    "Damage and false changes": changes.cells(),
}
HEAD: Final = """# Honest maps

```
python -m benchmarks.honest_maps --seeds 40      # measures what stands here, and writes this page
```

σ = 0.4 l/min of noise at 100 Hz; valves and circumstances are those of
`benchmarks/circumstances.py`, seeds from {first} on, which no test uses. *Inside* is within 5 % of
U and 5 bar of three samples at least. A cell is met where its figure is within the bar; where
fewer seeds were measured than the bar asks for, that stands beside, and the verdict is *so far*:
a coverage of three seeds is known to some .07. ± is the standard error over
seeds. `{code}` is the state of `service/valvemap/model` that was measured; a cell with another mark
is of an earlier one.
"""


def circuit(which: str, _seed: int) -> Figures:
    """R² one step ahead on the cooling circuit."""
    return {"r2": one_step_ahead(measured_data.cooling_circuit(), CIRCUIT[which][0])}


def judge_circuit(which: str, found: Sequence[Figures]) -> Judged:
    """One recording, one figure."""
    r2, least = found[0]["r2"], CIRCUIT[which][1]
    return Judged(f"R² {r2:.5f}", f"≥ {least}", r2 >= least)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, keep, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=FIRST)
    parser.add_argument("--only", default="")
    parser.add_argument("--page", action="store_true", help="write the page alone")
    wanted = parser.parse_args(arguments)
    kept, code = _kept(), _code()
    for name, cell in (item for cells in _sections().values() for item in cells.items()):
        if wanted.only not in name or wanted.page:
            continue
        of = kept.setdefault(cell.shared or name, {"code": code, "seeds": {}})
        if of["code"] != code:
            of.update(code=code, seeds={})
        began = time.perf_counter()
        for seed in range(wanted.first, wanted.first + min(wanted.seeds, cell.seeds)):
            if str(seed) not in of["seeds"]:
                of["seeds"][str(seed)] = cell.one(seed)
                results_file.keep(RESULTS, kept)
        told = cell.judge(list(of["seeds"].values()))
        took = time.perf_counter() - began
        print(f"{name}: {told.figure} [{'met' if told.met else 'MISSED'}] {took:.0f} s", flush=True)
        if wanted.first == FIRST:
            PAGE.write_text(_page(kept, code), "utf-8")
    if wanted.page:
        PAGE.write_text(_page(kept, code), "utf-8")
    return 0


def _sections() -> Mapping[str, Mapping[str, Cell]]:
    of_circuit = {
        f"cooling circuit, {which}": Cell(1, partial(circuit, which), partial(judge_circuit, which))
        for which in CIRCUIT
    }
    return {**SECTIONS, "Bars of before": of_circuit}


def _page(kept: Mapping[str, Any], code: str) -> str:
    lines = [HEAD.format(first=FIRST, code=code)]
    for title, cells in _sections().items():
        lines += [f"\n## {title}\n", "| cell | seeds | figure | bar | |", "|---|---|---|---|---|"]
        for name, cell in cells.items():
            of = kept.get(cell.shared or name, {"code": code, "seeds": {}})
            if not of["seeds"]:
                lines.append(f"| {name} | 0 of {cell.seeds} | not measured | | |")
                continue
            told, done = cell.judge(list(of["seeds"].values())), len(of["seeds"])
            seeds = f"{done}" if done >= cell.seeds else f"{done} of {cell.seeds}"
            mark = "" if of["code"] == code else f" `{of['code']}`"
            verdict = "met" if told.met else "**missed**"
            verdict += "" if done >= cell.seeds else " so far"
            lines.append(f"| {name} | {seeds} | {told.figure} | {told.bar} | {verdict}{mark} |")
    lines += [
        "\n## Feed-forward\n",
        "Fallback within 1 s, range and slew never left; each a test over OPC UA in",
        "`tests/app/test_feedforward_trusted.py`, run by `make test`:\n",
        *(f"- {circumstance}: `{test}`" for circumstance, test in FEED_FORWARD.items()),
    ]
    return "\n".join(lines) + "\n"


def _kept() -> dict[str, Any]:
    return json.loads(RESULTS.read_text("utf-8")) if RESULTS.exists() else {}


def _code() -> str:
    """Mark of the estimators as they are."""
    digest = hashlib.sha256()
    for path in sorted(CORE.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:8]


if __name__ == "__main__":
    sys.exit(main())
