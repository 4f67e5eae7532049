"""Kernels that were compiled when the wheel was made: which of them this machine can run.

A platform wheel holds the caches of two kinds of machine: x86-64-v3 (with AVX2 and FMA: nearly all
since 2015) and generic x86-64. They belong to one version of Python and one of numba; with any
other, and elsewhere, kernels are compiled at the first start. Entries are found by the stamps of
their modules, so that they are good wherever the wheel is installed, and no longer than its code
stays. ``NUMBA_CPU_NAME`` chooses a kind, or neither.
"""

import os
import sys
import sysconfig
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Final

from llvmlite import binding
from numba.core import config

INTO: Final = "VALVEMAP_COMPILE_INTO"
"""Environment of a process that compiles for a wheel: the folder where everything is cached."""

_V3: Final = "sse3 ssse3 sse4.1 sse4.2 popcnt cx16 sahf avx avx2 bmi bmi2 f16c fma lzcnt movbe"
KINDS: Final = {
    "x86-64-v3": frozenset(_V3.split()),
    "generic": frozenset[str](),
}
"""Each kind as LLVM calls it, and the features that it needs, the best first."""

COMPLETE: Final = "complete"
"""File beside the caches: the stamp of all kernels when they were compiled."""

BITCODES: Final = "bitcode.xz"
"""File beside the caches: the bitcode by which the kernels are linked into others."""

HOME: Final = Path(__file__).parent / "compiled_ahead"


def into() -> Path | None:
    """Where this process compiles to, if it does so for a wheel."""
    folder = os.environ.get(INTO)
    return Path(folder) if folder else None


@cache
def folder() -> Path | None:
    """The caches that were shipped for a machine like this one, if there are any."""
    kind = kind_of_machine()
    if kind is None or into() is not None:
        return None
    found = HOME / place(kind)
    return found if found.is_dir() else None


def place(kind: str) -> str:
    """Folder of the caches of one kind for the running Python and numba."""
    python = f"{sysconfig.get_platform()}-{sys.implementation.cache_tag}"
    return f"{python}-numba-{version('numba')}/{kind}"


def kind_of_machine() -> str | None:
    """Return the best kind that runs here, or the one that ``NUMBA_CPU_NAME`` asks for."""
    if config.CPU_NAME is not None or config.CPU_FEATURES is not None:
        known = config.CPU_NAME in KINDS and not config.CPU_FEATURES
        return str(config.CPU_NAME) if known else None
    present = {name for name, there in binding.get_host_cpu_features().items() if there}
    return next((kind for kind, needed in KINDS.items() if needed <= present), None)
