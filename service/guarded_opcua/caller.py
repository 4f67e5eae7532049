"""The user of the current write or method call, as a context variable."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_name: ContextVar[str] = ContextVar("caller", default="")


def caller() -> str:
    """Return the name of the user whose write or call is executed; empty outside of one."""
    return _name.get()


@contextmanager
def acting_for(name: str) -> Iterator[None]:
    """Set the user for the duration of a write or call.

    >>> with acting_for("operator"):
    ...     caller()
    'operator'
    """
    token = _name.set(name)
    try:
        yield
    finally:
        _name.reset(token)
