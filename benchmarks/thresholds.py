"""The thresholds of `Auto`, as its sources have them: found, and changed.

A threshold is a number, or a tuple of numbers, with a name of its own at the top of a module and,
on its line, a comment that gives unit and reason.
"""

import ast
import importlib.util
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

ROOM: Final = "valvemap.model"
_FOLDER: Final = Path(__file__).parents[1] / "service" / ROOM.replace(".", "/")
# What `Auto` consists of: python alone, and the compiled loops that no other estimator has.
PURE: Final = (
    *sorted(path.stem for path in _FOLDER.glob("auto*.py")),
    *("fit_budget", "drift", "map_search", "lag_search"),
)
_LOOPS: Final = "cells", "grid", "lag", "climb", "map_fit", "ladder"
KERNELS: Final = tuple(f"kernels.{name}" for name in _LOOPS)


# Numbers that say where something is, or how much room it has: nothing to halve or double.
LAYOUT: Final = {
    *(f"kernels.cells.{name}" for name in ("PLAY", "REFERENCE", "LAGGING")),
    *(f"kernels.lag.{name}" for name in ("OFFSET", "CURVED", "KNOWN_LAGS", "COUNTERS")),
    *(
        "auto_fits.STARTED",
        "map_search.RICH",
        "kernels.grid.SLOTS",
        "kernels.grid.OF_ONE_DIRECTION",
    ),
    "kernels.ladder.MOST_NEIGHBOURS",
}


def thresholds(modules: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Module and name of every threshold."""
    for module in modules:
        for name, explained in _numbers(module):
            if explained:
                yield module, name


def unexplained(modules: Sequence[str]) -> list[str]:
    """Numbers with a name that no comment on their line explains."""
    return [
        f"{module}.{name}"
        for module in modules
        for name, explained in _numbers(module)
        if not explained
    ]


def _numbers(module: str) -> Iterator[tuple[str, bool]]:
    """Numbers with a name that are no layout, and whether a comment explains them."""
    text = source(module)
    lines = text.splitlines()
    for node in ast.parse(text).body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and not _counts_up(node.value):
            explained = "#" in lines[(node.end_lineno or 1) - 1]
            for name, value in _assigned(node):
                if _is_number(value) and f"{module}.{name}" not in LAYOUT:
                    yield name, explained


def _counts_up(value: ast.expr | None) -> bool:
    """Whether it is a list of places: whole numbers, each one more than the one before."""
    if not isinstance(value, ast.Tuple) or not _is_number(value):
        return False
    found = [_value(number) for number in value.elts]
    return found == list(range(int(found[0]), int(found[0]) + len(found)))


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


def scaled(text: str, name: str, factor: float) -> ast.Module:
    """The same module with one threshold times a factor; a whole number stays one, and above 0."""
    tree = ast.parse(text)
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


def source(module: str) -> str:
    """What a module of the room says."""
    return _FOLDER.joinpath(*module.split(".")).with_suffix(".py").read_text("utf-8")


def change(module: str, name: str, factor: float) -> None:
    """Have one module, not imported yet, come into being with another threshold."""
    whole = f"{ROOM}.{module}"
    spec = importlib.util.find_spec(whole)
    assert spec is not None and spec.origin is not None  # noqa: PT018, S101 - it is ours
    tree = scaled(source(module), name, factor)
    made = importlib.util.module_from_spec(spec)
    sys.modules[whole] = made
    exec(compile(tree, spec.origin, "exec"), made.__dict__)  # noqa: S102 - our own module
