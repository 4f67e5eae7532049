"""Stamp of everything that a kernel is compiled from: its module and all imports, transitively.

Numba's cache compares a function's own file only, not those of the functions that it calls. A
stamp covers the module, and every module of the same package that it imports, directly or through
others. It covers their syntax trees without comments, docstrings and line numbers: changed comments
do not change a stamp.

Parsing fifty modules takes a tenth of a second. `Trees` caches the result by the hash of the file's
bytes, so that a later process only hashes them.
"""

import ast
import hashlib
import json
import os
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True)
class Tree:
    """The parts of a module's file that affect compilation."""

    content: str  # hash of the syntax tree
    imports: tuple[str, ...]  # names in full; `from a import b` is `a:b`


@dataclass
class Trees:
    """Syntax trees of modules, cached in a file if one is given: the newest of each module.

    ``came`` is another, read-only cache file.
    """

    kept: Path | None = None
    came: Path | None = None
    _by_file: dict[Path, Tree] = field(default_factory=dict)
    _known: dict[str, tuple[str, Tree]] = field(default_factory=dict)  # by module, with the hash
    _parsed: bool = False  # any, since they were kept

    def __post_init__(self) -> None:
        for file in (self.came, self.kept):
            if file is not None:
                self._known |= _read(file)

    def of(self, file: Path, module: str) -> Tree:
        """Return the tree of a module; its name resolves relative imports. A file is read once."""
        if file not in self._by_file:
            self._by_file[file] = self._of_bytes(file, module)
        return self._by_file[file]

    def _of_bytes(self, file: Path, module: str) -> Tree:
        source, is_package = file.read_bytes(), file.name == "__init__.py"
        digest = hashlib.sha256(repr(is_package).encode() + source).hexdigest()
        known, tree = self._known.get(module, ("", Tree("", ())))
        if known != digest:
            tree = parse(source, module, is_package=is_package)
            self._known[module] = digest, tree
            self._parsed = True
        return tree

    def keep(self) -> None:
        """Write all to the file, if any was parsed and the file is writable."""
        if self.kept is None or not self._parsed:
            return
        self._parsed = False
        written = {
            module: [digest, tree.content, *tree.imports]
            for module, (digest, tree) in self._known.items()
        }
        beside = self.kept.with_suffix(f".{os.getpid()}")
        try:
            beside.write_text(json.dumps(written), encoding="utf-8")
            beside.replace(self.kept)
        except OSError:  # parsed again by the next process
            beside.unlink(missing_ok=True)


def stamp_of_module(module: str, file: Path, trees: Trees) -> str:
    """Return the stamp of an imported module; imports of its package and of ours are followed."""
    return stamp_of_modules({module: file}, trees)


def stamp_of_modules(files: Mapping[str, Path], trees: Trees) -> str:
    """Return one stamp of several modules, by name in full, and of all that they import."""
    packages = {
        top: Path(path)
        for top in dict.fromkeys(
            (*(m.partition(".")[0] for m in files), __name__.partition(".")[0])
        )
        for path in getattr(sys.modules.get(top), "__path__", ())
    }
    return _stamp(list(files.items()), packages, trees)


def stamp_of(file: Path, module: str, packages: Mapping[str, Path], trees: Trees) -> str:
    """Return the stamp of a module; equal stamps mean equal code of it and of all its imports.

    Parameters
    ----------
    file, module
        The module's file, and its name in full (or ``__main__``).
    packages
        Packages whose modules are followed, by name, with their folders. All other imports belong
        to other distributions.
    trees
        Cache of parsed modules.
    """
    return _stamp([(module, file)], packages, trees)


def _stamp(ahead: list[tuple[str, Path]], packages: Mapping[str, Path], trees: Trees) -> str:
    contents: dict[str, str] = {}
    while ahead:
        name, path = ahead.pop()
        if name in contents:
            continue
        tree = trees.of(path, name)
        contents[name] = tree.content
        for imported in tree.imports:
            found = _find(imported, packages)
            if found is not None:
                ahead.append(found)
    lines = (f"{name} {content}\n" for name, content in sorted(contents.items()))
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def parse(source: bytes, module: str, *, is_package: bool = False) -> Tree:
    r"""Parse a module's source.

    Examples
    --------
    >>> one = parse(b"import a.b  # for the filter", "c")
    >>> one == parse(b"# Filters.\nimport a.b", "c"), one.imports
    (True, ('a.b',))
    """
    tree = ast.parse(source)
    imports = dict.fromkeys(_imports(tree, module, is_package=is_package))
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [one for one in body if not _is_text(one)]  # type: ignore[attr-defined]
    dump = ast.dump(tree, annotate_fields=False)
    return Tree(hashlib.sha256(dump.encode()).hexdigest(), tuple(imports))


def _imports(tree: ast.Module, module: str, *, is_package: bool) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            origin = node.module or ""
            if node.level:
                parts = module.split(".")
                parents = parts[: len(parts) - node.level + is_package]
                origin = ".".join([*parents, *([node.module] if node.module else [])])
            yield from (f"{origin}:{alias.name}" for alias in node.names)


def _is_text(statement: ast.stmt) -> bool:
    """Whether a statement is a docstring, or a string below a constant."""
    return (
        isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
    )


def _find(imported: str, packages: Mapping[str, Path]) -> tuple[str, Path] | None:
    """Return name and file of the module behind an import, if it belongs to one of the packages."""
    origin, _, name = imported.partition(":")
    for module in (f"{origin}.{name}", origin) if name else (origin,):
        top, *rest = module.split(".")
        if top not in packages:
            return None
        place = packages[top].joinpath(*rest)
        for file in (place.with_suffix(".py") if rest else place, place / "__init__.py"):
            if file.is_file():
                return module, file
    return None


def _read(kept: Path) -> dict[str, tuple[str, Tree]]:
    try:
        found = json.loads(kept.read_text(encoding="utf-8"))
        return {
            module: (digest, Tree(content, tuple(imports)))
            for module, (digest, content, *imports) in found.items()
        }
    except (OSError, ValueError, AttributeError, TypeError):  # missing, or another program's
        return {}
