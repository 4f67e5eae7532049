"""This tree beside an older one, in turns: ``python -m benchmarks.pairs OLD_TREE [PAIRS] [PART…]``.

Each part runs in a process of either tree's own Python (``.venv``), first one tree and then the
other, and the next pair the other way round. Speeds are processor time, so other programs disturb
little; printed are the median of each tree and the median of the pairs' ratios, new over old.
"""

import json
import statistics
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Final

PARTS: Final = {
    "kernels, ns per sample": """
from benchmarks import kernel_speed
found = kernel_speed.whole_estimators()
""",
    "default replay, us per sample": """
from benchmarks import auto_speed
found = {"all": 1e6 / auto_speed.default_configuration(20, 5_000)["replay"]}
""",
    "live RLS, us per notification": """
from benchmarks import live_speed
one = live_speed.measured(200, 20.0, 15.0)
found = {"200 valves": 1e6 * one["cores of the service"] / one["reached, notifications/s"]}
""",
    "memory, bytes per valve": """
from benchmarks import default_speed
default_speed.MEMORISED, default_speed.MEMORISED_SAMPLES = (20, 120), 500
found = default_speed.memory()
""",
}
"""Code by title: it leaves figures by name, lower is better, in `found`."""

Figures = dict[str, float]


def main(arguments: list[str]) -> int:
    """Measure pairs, and print them."""
    old, *rest = arguments
    pairs = int(rest[0]) if rest else 10
    for title, code in PARTS.items():
        if not rest[1:] or any(title.startswith(part) for part in rest[1:]):
            _show(title, [_pair(Path(old), code, turn) for turn in range(pairs)])
    return 0


def _pair(old: Path, code: str, turn: int) -> tuple[Figures, Figures]:
    trees = [old, Path.cwd()]
    found = {tree: _measured(tree, code) for tree in (trees if turn % 2 else trees[::-1])}
    return found[trees[0]], found[trees[1]]


def _measured(tree: Path, code: str) -> Figures:
    command = [str(tree / ".venv" / "bin" / "python"), "-c", f"{code}\nimport json\n{_PRINT}"]
    ended = subprocess.run(command, cwd=tree, capture_output=True, text=True, check=True)
    figures: Mapping[str, float] = json.loads(ended.stdout.splitlines()[-1])
    return dict(figures)


_PRINT: Final = "print(json.dumps({n: x for n, x in found.items() if isinstance(x, int | float)}))"


def _show(title: str, pairs: list[tuple[Figures, Figures]]) -> None:
    print(f"{title} ({len(pairs)} pairs)")
    for name in pairs[0][0]:
        old, new = ([figures[name] for figures in each] for each in zip(*pairs, strict=True))
        ratio = statistics.median(b / a for a, b in zip(old, new, strict=True))
        before, after = statistics.median(old), statistics.median(new)
        print(f"  {name:40} {before:12.2f} {after:12.2f}  x {ratio:.3f}", flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
