"""Hides optional packages that libraries import if installed, but no command needs."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def without(package: str) -> Iterator[None]:
    """Import as if a package were not installed, unless it was imported already.

    Examples
    --------
    >>> with without("a_package_of_nobody"):
    ...     import a_package_of_nobody
    Traceback (most recent call last):
        ...
    ModuleNotFoundError: import of a_package_of_nobody halted; None in sys.modules
    """
    hidden = package not in sys.modules
    if hidden:
        sys.modules[package] = None  # type: ignore[assignment]
    try:
        yield
    finally:
        if hidden:
            del sys.modules[package]
