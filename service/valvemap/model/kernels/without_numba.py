"""Kernels as plain Python, in a process that does without numba: see `interpreted`."""

from collections.abc import Callable
from typing import Any, Final, TypeVar

from valvemap.model.kernels.interpreted import Plain
from valvemap.model.kernels.stamps import Trees

F = TypeVar("F", bound=Callable[..., object])

TREES: Final = Trees()
"""Syntax trees of kernels' modules; none is compiled."""


def called(function: F, *, counts: bool) -> F:  # noqa: ARG001 - Python counts them all
    """Return a function that runs as a kernel does."""
    return spliced(function)


def linked(function: F, *, counts: bool, **options: Any) -> F:  # noqa: ANN401, ARG001
    """Return a function that only kernels call."""
    return spliced(function)


def spliced(function: F, **options: Any) -> F:  # noqa: ANN401, ARG001
    """Return a function that runs as a kernel does."""
    plain: Any = Plain(function)
    found: F = plain
    return found


def keep(dispatcher: object) -> None:
    """Do nothing: there is no cache."""


def take_shortcuts() -> None:
    """Do nothing: there is no numba."""
