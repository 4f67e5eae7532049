"""Figures of the code itself: ``python -m benchmarks.house [PART …]``, all without a part.

- *forwarding*: methods whose body is one call with their own arguments (`benchmarks.forwarding`);
- *concrete*: lines outside the model that ask whether an object is a certain estimator;
- *quick*: CPU of ``valvemap --help`` and of ``valvemap invert``, the median of five;
- *comment*: CPU of a replay (2,000 samples, RLS) after a comment in one kernel file of the
  pipeline, in a copy of the tree with its compiled kernels; the worst of `EDITED`.
"""

import ast
import os
import resource
import shutil
import statistics
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.forwarding import SERVICE, forwarding

ROOT = SERVICE.parent
CONCRETE = {"RecursiveLeastSquares", "MaximumLikelihood", "RbfNetwork", "FlowMap"}
EDITED = "gate", "lanes", "places"
COPIED = "service", "virtual_rig", "config"
RUNS, N = 5, 2_000
ONE = '[[valves]]\nname = "Valvistor"\nestimators = [{ kind = "RLS" }]\n'


def main(parts: list[str]) -> None:
    """Print a row of a table for each figure."""
    every: dict[str, Callable[[], None]] = {
        "forwarding": _forwarding,
        "concrete": _concrete,
        "quick": _quick,
        "comment": _comment,
    }
    print("| figure | measured | bar |\n|---|---|---|")
    for part in parts or every:
        every[part]()


def _forwarding() -> None:
    print(f"| forwarding methods | {len(list(forwarding()))} | < 70 |")


def _concrete() -> None:
    found = [
        f"{file.relative_to(SERVICE)}:{node.lineno}"
        for file in SERVICE.rglob("*.py")
        if "model" not in file.relative_to(SERVICE).parts
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == "isinstance"
        and any(isinstance(one, ast.Name) and one.id in CONCRETE for one in ast.walk(node.args[1]))
    ]
    print(f"| `isinstance` on a concrete estimator {' '.join(found)} | {len(found)} | 0 |")


def _quick() -> None:
    with TemporaryDirectory() as folder:
        recording, model = Path(folder) / "plant.csv", Path(folder) / "model.json"
        _write(recording)
        _valvemap_s("replay", recording, "--save", model)
        for words, bar in (
            (("--help",), 0.3),
            (("invert", model, "--Q", "20", "--dp", "70"), 0.7),
        ):
            seconds = statistics.median(_valvemap_s(*words) for _ in range(RUNS))
            print(f"| `{words[0]}`, s of CPU | {seconds:.2f} | ≤ {bar} |")


def _comment() -> None:
    with TemporaryDirectory() as folder:
        tree = Path(folder)
        for name in COPIED:
            shutil.copytree(ROOT / name, tree / name)
        recording, config = tree / "plant.csv", tree / "rls.toml"
        _write(recording)
        config.write_text(ONE, encoding="utf-8")
        replayed = "replay", recording, "--config", config
        _valvemap_s(*replayed, tree=tree)  # compiles what the copy lacks
        before = _valvemap_s(*replayed, tree=tree)
        worst, named = 0.0, ""
        for name in EDITED:
            kernel = tree / "service/valvemap/pipeline/kernels" / f"{name}.py"
            kernel.write_text(
                kernel.read_text(encoding="utf-8") + "# a comment\n", encoding="utf-8"
            )
            worst, named = max((worst, named), (_valvemap_s(*replayed, tree=tree), name))
        print(
            f"| replay after a comment in `{named}.py`, s of CPU ({before:.1f} before) "
            f"| {worst:.1f} | ≤ 6 |"
        )


def _valvemap_s(*words: object, tree: Path = ROOT) -> float:
    """Run a command of the code in a tree; return its processor time."""
    paths = os.pathsep.join(str(tree / name) for name in ("service", "virtual_rig"))
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-m", "valvemap", *map(str, words)],
        env=os.environ | {"PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1"},
        cwd=tree,
        check=True,
        capture_output=True,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _write(recording: Path) -> None:
    rng = np.random.default_rng(1)
    U, dp = rng.uniform(0, 100, N), rng.uniform(1, 200, N)
    Q = 0.1 * U * np.sqrt(dp) + 0.2 * rng.normal(size=N)
    columns = np.arange(N) / 100, U, np.full(N, 200.0), 200.0 - dp, Q, np.full(N, 40.0)
    rows = np.column_stack(columns)
    np.savetxt(recording, rows, "%.6f", ",", header="t,U,p1,p2,Q,T", comments="")


if __name__ == "__main__":
    main(sys.argv[1:])
