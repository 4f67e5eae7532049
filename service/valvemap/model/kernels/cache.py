"""The cache of compiled kernels: numba's own files with another stamp.

Each kernel has a separate cache (`keep`); numba is not changed. It is in numba's location:
``NUMBA_CACHE_DIR``, else beside the module, else in the user's cache. Kernels missing there are
read from the wheel's (`kernels.ahead`). An entry is valid while the module's stamp
(`kernels.stamps`) is unchanged, wherever the package is installed.

Private parts of numba: a dispatcher's ``_cache`` and the classes of ``numba.core.caching``.
"""

import sys
from functools import cache
from glob import escape
from pathlib import Path
from typing import Any, Final

from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    IndexDataCacheFile,
    _CacheLocator,
)
from numba.core.compiler import CompileResult

from valvemap.model.kernels import ahead
from valvemap.model.kernels.numba_libraries import load_library
from valvemap.model.kernels.stamps import Trees, stamp_of_module


def keep(dispatcher: Any) -> None:  # noqa: ANN401 - numba has no types
    """Cache a dispatcher's code under its module's stamp."""
    dispatcher._cache = _Cache(dispatcher.py_func)  # noqa: SLF001


@cache
def _stamp(module: str, file: str) -> str:
    stamp = stamp_of_module(module, Path(file), TREES)
    TREES.keep()
    return stamp


@cache
def _folder(file: str) -> str | None:
    """Return numba's cache folder for a file; None if there is none."""
    for locator in CompileResultCacheImpl._locator_classes:  # noqa: SLF001
        found = locator.from_function(_folder.__wrapped__, file)
        if found is not None:
            return str(found.get_cache_path())
    return None


class _Locator(_CacheLocator):
    def __init__(self, folder: str, stamp: str) -> None:
        self._folder = folder
        self._stamp = stamp

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> "_Locator | None":  # noqa: ANN401
        into = ahead.into()
        folder = _folder(py_file) if into is None else str(into / py_func.__module__)
        return None if folder is None else cls(folder, _stamp(py_func.__module__, py_file))

    def get_cache_path(self) -> str:
        return self._folder

    def get_source_stamp(self) -> str:
        return self._stamp

    def get_disambiguator(self) -> str:
        """Return a part of the file names: numba writes an index before the code that it names.

        If names were equal before and after a change, an interrupted or concurrent process would
        load old code as new. The line number is not part of it, since comments change it.
        """
        return self._stamp[:12]


class _Impl(CompileResultCacheImpl):
    _locator_classes = (_Locator,)

    def rebuild(self, target_context: Any, payload: Any) -> Any:  # noqa: ANN401
        loading = _Loading(target_context)
        return CompileResult._rebuild(loading, *payload)._replace(target_context=target_context)  # noqa: SLF001


class _Cache(FunctionCache):
    _impl_class = _Impl

    def _load_overload(self, sig: Any, target_context: Any) -> Any:  # noqa: ANN401
        found = super()._load_overload(sig, target_context)
        if found is not None or ahead.folder() is None:
            return found
        data = self._compiled_ahead(self._index_key(sig, target_context.codegen()))
        return None if data is None else self._impl.rebuild(target_context, data)

    def _compiled_ahead(self, key: Any) -> Any:  # noqa: ANN401
        """Return the entry for this kind of machine; its key names the build machine."""
        place = str(ahead.folder() / self._py_func.__module__)
        stamp = self._impl.locator.get_source_stamp()
        kept = IndexDataCacheFile(place, self._impl.filename_base, stamp)
        sig, _, code = key
        for known in kept._load_index():  # noqa: SLF001
            if (known[0], known[2]) == (sig, code):
                return kept.load(known)
        return None

    def save_overload(self, sig: Any, data: Any) -> None:  # noqa: ANN401
        """Save, and remove entries of older stamps."""
        super().save_overload(sig, data)
        base = self._impl.filename_base
        name, stamp = base.rsplit("-", 1)
        python = stamp.partition(".")[2]
        for file in Path(self._cache_path).glob(f"{escape(name)}-*.{python}.*"):
            if not file.name.startswith(f"{base}."):
                file.unlink(missing_ok=True)


class _Loading:
    """Numba's target while a kernel is loaded: it can also load our libraries."""

    def __init__(self, target: Any) -> None:  # noqa: ANN401
        self._target = target

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        return getattr(self._target, name)

    def codegen(self) -> "_Loading":
        return self

    def unserialize_library(self, state: Any) -> Any:  # noqa: ANN401
        return load_library(self._target.codegen(), state)


def _read_before() -> Trees:
    name, came = f"trees.{sys.implementation.cache_tag}", ahead.folder()
    into, folder = ahead.into(), _folder(__file__)
    place = folder if into is None else str(into)
    return Trees(None if place is None else Path(place) / name, came and came / name)


TREES: Final = _read_before()
"""Syntax trees of kernels' modules, from this process and earlier ones."""
