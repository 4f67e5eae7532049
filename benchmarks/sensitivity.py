"""Which thresholds of `Auto` matter: each halved and doubled, ``python -m benchmarks.sensitivity``.

Writes ``docs/sensitivity.md``: those that move a figure by more than a tenth. A threshold is a
number with a name and, on its line, a comment. With ``kernels`` those of the compiled loops are
tried, too; each is compiled anew, so that takes hours.
"""

import ast
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

PAGE = Path(__file__).parents[1] / "docs" / "sensitivity.md"
ROOM: Final = "service.identification"
PURE: Final = "auto", "fit_budget", "drift", "map_search", "lag_search"
KERNELS: Final = "kernels.cells", "kernels.grid", "kernels.lag", "kernels.climb", "kernels.map_fit"
MOVED: Final = 0.1  # share of a figure that counts as moved
SEEDS: Final = 3
N, CHANGED_AT, LOST = 10_000, 6_000, 0.08  # samples; when the valve loses a share of its flow
SPACING: Final = 10_000_000  # ns: 100 Hz
SIGMA: Final = 0.4  # l/min, noise of Q
METER_LAG: Final = 0.06  # s

INTRODUCTION = """# Sensitivity

Made by `python -m benchmarks.sensitivity`; do not edit. Every threshold of `Auto` was halved and
doubled; here are those that moved a figure by more than a tenth, with the figure over what it is
without. 1.00 is no difference, larger is worse; *fails* is an error.
"""


def figures() -> dict[str, float]:
    """What the thresholds are held against, of a few valves; all of it the same on any machine."""
    learnt = [_learnt(seed) for seed in range(SEEDS)]
    found: dict[str, float] = {}
    for name in learnt[0]:
        found[name] = float(np.mean([one[name] for one in learnt]))
    return found


def _learnt(seed: int) -> dict[str, float]:
    from benchmarks.auto_speed import ramps_and_holds  # noqa: PLC0415 - after a change
    from service.identification.auto import Auto  # noqa: PLC0415
    from service.identification.kernels import cells  # noqa: PLC0415
    from service.identification.samples import Samples  # noqa: PLC0415

    rng = np.random.default_rng(seed)
    U, dp = ramps_and_holds(rng, N, 0, 100), ramps_and_holds(rng, N, 3, 195)
    auto, said = Auto(), {}
    grid = [x.ravel() for x in np.meshgrid(np.linspace(5, 95, 19), np.linspace(10, 180, 9))]

    def samples_of(Q: Floats) -> Samples:
        return Samples.of(SPACING * np.arange(N), U, dp, 0.0 * dp, Q)

    def error(state: Any, share: float) -> float:
        Q, _ = auto.predict(state, *grid, np.full(len(grid[0]), 40.0))
        return float(np.sqrt(np.nanmean((Q - share * _flow(*grid)) ** 2))) / SIGMA

    steady = samples_of(_flow(U, dp) + SIGMA * rng.standard_normal(N))
    state, _ = auto.update(auto.initial_state(), steady[:1_000])
    said["map after 1,000 samples, σ"] = error(state, 1.0)
    state, _ = auto.update(state, steady[1_000:])
    said["map after 10,000 samples, σ"] = error(state, 1.0)
    said["work, µs per sample"] = float(state.counters[cells.SPENT]) / 1e3 / N
    said["false alarms and 1"] = 1.0 + float(state.counters[cells.ALARMS])
    share = np.where(np.arange(N) < CHANGED_AT, 1.0, 1.0 - LOST)
    changed = samples_of(share * _flow(U, dp) + SIGMA * rng.standard_normal(N))
    state, _ = auto.update(auto.initial_state(), changed[:CHANGED_AT])
    before, at = int(state.counters[cells.ALARMS]), CHANGED_AT
    while at < N and state.counters[cells.ALARMS] == before:
        state, _ = auto.update(state, changed[at : at + 10])
        at += 10
    said["change found after, samples"] = float(at - CHANGED_AT)
    state, _ = auto.update(state, changed[at:])
    said["map 4,000 samples after a change, σ"] = error(state, 1.0 - LOST)
    late = _behind(_flow(U, dp), METER_LAG) + SIGMA * rng.standard_normal(N)
    state, _ = auto.update(auto.initial_state(), samples_of(late))
    said["lag of the meter off by, ms, and 1"] = 1.0 + 1e3 * abs(auto.lags(state)[1] - METER_LAG)
    said["map behind a meter that lags, σ"] = error(state, 1.0)
    return said


def _flow(U: Floats, dp: Floats) -> Floats:
    """A valve with a dead band of 6 % that saturates at 93 %."""
    opening = np.clip((U - 6.0) / 87.0, 0.0, 1.0)
    return np.asarray(13.0 * opening * (1.1 - 0.1 * opening) * np.sqrt(dp))


def _behind(Q: Floats, tau: float) -> Floats:
    """What a meter of first order shows of Q at 100 Hz."""
    shown, share = Q.copy(), -np.expm1(-0.01 / tau)
    for k in range(1, len(Q)):
        shown[k] = shown[k - 1] + share * (Q[k - 1] - shown[k - 1])
    return shown


def thresholds(modules: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Module and name of every number with a name and a comment on its line."""
    for module in modules:
        source = _source(module)
        lines = source.splitlines()
        for node in ast.parse(source).body:
            if "#" in lines[(node.end_lineno or 1) - 1]:
                for name, value in _assigned(node):
                    if _is_number(value):
                        yield module, name


def _assigned(node: ast.stmt) -> list[tuple[str, ast.expr]]:
    """Names that a statement gives, with what it gives them."""
    match node:
        case ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value):
            return [(name, value)]
        case ast.Assign(targets=[ast.Name(id=name)], value=value):
            return [(name, value)]
        case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Tuple(elts=values)):
            pairs = zip(names, values, strict=True)
            return [(name.id, value) for name, value in pairs if isinstance(name, ast.Name)]
    return []


def _is_number(value: ast.expr) -> bool:
    return all(
        isinstance(node, ast.BinOp | ast.operator)
        or (isinstance(node, ast.Constant) and isinstance(node.value, int | float))
        for one in (value.elts if isinstance(value, ast.Tuple) else [value])
        for node in ast.walk(one)
    )


def _value(number: ast.expr) -> float:
    found = eval(compile(ast.Expression(number), "", "eval"), {})  # noqa: S307 - of our own source
    assert isinstance(found, int | float)  # noqa: S101 - see `_is_number`
    return found


def _scaled(source: str, name: str, factor: float) -> ast.Module:
    """The same module with one threshold times a factor; a whole number stays one, and above 0."""
    tree = ast.parse(source)
    for statement in tree.body:
        for assigned, value in _assigned(statement):
            if assigned == name:
                numbers = value.elts if isinstance(value, ast.Tuple) else [value]
                for number in numbers:
                    _replace(tree, number, _times(_value(number), factor))
    return ast.fix_missing_locations(tree)


def _times(value: float, factor: float) -> float:
    return max(1, round(value * factor)) if isinstance(value, int) else value * factor


def _replace(tree: ast.Module, old: ast.expr, value: float) -> None:
    class Replacing(ast.NodeTransformer):
        def visit(self, node: ast.AST) -> Any:
            if node is old:
                return ast.copy_location(ast.Constant(value), old)
            return self.generic_visit(node)

    Replacing().visit(tree)


def _source(module: str) -> str:
    return (
        (Path(__file__).parents[1] / ROOM.replace(".", "/"))
        .joinpath(*module.split("."))
        .with_suffix(".py")
        .read_text("utf-8")
    )


def _change(module: str, name: str, factor: float) -> None:
    """Have one module, not imported yet, come into being with another threshold."""
    whole = f"{ROOM}.{module}"
    spec = importlib.util.find_spec(whole)
    assert spec is not None and spec.origin is not None  # noqa: PT018, S101 - it is ours
    tree = _scaled(_source(module), name, factor)
    made = importlib.util.module_from_spec(spec)
    sys.modules[whole] = made
    exec(compile(tree, spec.origin, "exec"), made.__dict__)  # noqa: S102 - our own module


def _measured(module: str, name: str, factor: float) -> Mapping[str, float]:
    """Figures of a process of its own; empty where it fails."""
    command = [sys.executable, "-m", "benchmarks.sensitivity", "one", module, name, str(factor)]
    with tempfile.TemporaryDirectory() as cache:
        own = {"NUMBA_CACHE_DIR": cache} if module.startswith("kernels") else {}
        done = subprocess.run(
            command, env=os.environ | own, capture_output=True, text=True, check=False
        )
    return json.loads(done.stdout) if done.returncode == 0 else {}


def main(arguments: Sequence[str]) -> int:
    """Measure one change, or all, and write the page."""
    if arguments[:1] == ["one"]:
        module, name, factor = arguments[1:]
        _change(module, name, float(factor))
        print(json.dumps(figures()))
        return 0
    modules = PURE + (KERNELS if "kernels" in arguments else ())
    base = figures()
    rows, tried = [], 0
    for module, name in thresholds(modules):
        tried += 1
        for factor in (0.5, 2.0):
            found = _measured(module, name, factor)
            moved = {key: found[key] / base[key] for key in found}
            moved = {key: ratio for key, ratio in moved.items() if abs(ratio - 1.0) > MOVED}
            what = ", ".join(f"{key}: {ratio:.2f}" for key, ratio in moved.items())
            print(f"{module}.{name} x {factor}: {what if found else 'fails'}", flush=True)
            if moved or not found:
                rows.append(f"| `{module}.{name}` | {factor} | {what if found else '*fails*'} |")
    lines = [INTRODUCTION, "| what | unchanged |", "|---|---|"]
    lines += [f"| {key} | {value:.3g} |" for key, value in base.items()]
    lines += ["", f"{tried} thresholds of {', '.join(f'`{m}`' for m in modules)} were tried.", ""]
    lines += ["| threshold | times | moves |", "|---|---|---|", *rows]
    PAGE.write_text("\n".join(lines) + "\n", "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
