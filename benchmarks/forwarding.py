"""Counts methods whose body is one call with their own arguments.

``python -m benchmarks.forwarding`` lists them.
Each could be saved if its callers held the part that it forwards to.
"""

import ast
from collections.abc import Iterator
from pathlib import Path

SERVICE = Path(__file__).parents[1] / "service"


def forwarding(folder: Path = SERVICE) -> Iterator[str]:
    """Yield file, line and name of each such method."""
    for file in sorted(folder.rglob("*.py")):
        for kind in ast.walk(ast.parse(file.read_text())):
            for one in kind.body if isinstance(kind, ast.ClassDef) else ():
                if isinstance(one, ast.FunctionDef | ast.AsyncFunctionDef) and _forwards(one):
                    yield f"{file.relative_to(folder)}:{one.lineno} {one.name}"


def _forwards(method: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    body = [part for part in method.body if not _is_text(part)]
    if len(body) != 1 or not isinstance(body[0], ast.Return | ast.Expr):
        return False
    value = body[0].value
    call = value.value if isinstance(value, ast.Await) else value
    given = method.args
    names = [one.arg for one in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
    if not isinstance(call, ast.Call) or names[:1] not in (["self"], ["cls"]):
        return False
    own = {*names[1:], *([given.vararg.arg] if given.vararg else [])}
    passed = [one.value if isinstance(one, ast.Starred) else one for one in call.args]
    passed += [one.value for one in call.keywords]
    return {one.id for one in passed if isinstance(one, ast.Name)} == own and len(passed) == len(
        own
    )


def _is_text(part: ast.stmt) -> bool:
    return isinstance(part, ast.Expr) and isinstance(part.value, ast.Constant)


if __name__ == "__main__":
    found = list(forwarding())
    print("\n".join(found))
    print(f"{len(found)} methods")
