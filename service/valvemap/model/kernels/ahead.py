"""Kernels compiled when the wheel was built, and their selection for this machine.

A platform wheel contains caches for two kinds of machine: x86-64-v3 (with AVX2 and FMA: nearly all
since 2015) and generic x86-64. They are valid for one version of Python and one of numba; with any
other, and on other platforms, kernels are compiled at the first start. Entries are found by the
stamps of their modules: they are valid wherever the wheel is installed, until its code changes.
``NUMBA_CPU_NAME`` selects a kind, or neither.
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
"""Environment variable of a process that compiles for a wheel: folder of all caches."""

_V3: Final = "sse3 ssse3 sse4.1 sse4.2 popcnt cx16 sahf avx avx2 bmi bmi2 f16c fma lzcnt movbe"
KINDS: Final = {
    "x86-64-v3": frozenset(_V3.split()),
    "generic": frozenset[str](),
}
"""The kinds by LLVM's name, and the features that each needs, best first."""

COMPLETE: Final = "complete"
"""File beside the caches: stamp of all kernels when they were compiled."""

BITCODES: Final = "bitcode.xz"
"""File beside the caches: bitcode for linking the kernels into others."""

HOME: Final = Path(__file__).parent / "compiled_ahead"


def into() -> Path | None:
    """Return the output folder if this process compiles for a wheel."""
    folder = os.environ.get(INTO)
    return Path(folder) if folder else None


@cache
def folder() -> Path | None:
    """Return the wheel's caches for this machine, if any."""
    kind = kind_of_machine()
    if kind is None or into() is not None:
        return None
    found = HOME / place(kind)
    return found if found.is_dir() else None


def place(kind: str) -> str:
    """Return the folder of the caches of one kind for the running Python and numba."""
    python = f"{sysconfig.get_platform()}-{sys.implementation.cache_tag}"
    return f"{python}-numba-{version('numba')}/{kind}"


def kind_of_machine() -> str | None:
    """Return the best kind that this machine supports, or the one set in ``NUMBA_CPU_NAME``."""
    if config.CPU_NAME is not None or config.CPU_FEATURES is not None:
        known = config.CPU_NAME in KINDS and not config.CPU_FEATURES
        return str(config.CPU_NAME) if known else None
    present = {name for name, there in binding.get_host_cpu_features().items() if there}
    return next((kind for kind, needed in KINDS.items() if needed <= present), None)
