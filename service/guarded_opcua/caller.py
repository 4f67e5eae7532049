"""Who acts right now: methods and writes may ask, without being handed a session."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_name: ContextVar[str] = ContextVar("caller", default="")


def caller() -> str:
    """Name of the user whose write or call is being carried out; empty outside of one."""
    return _name.get()


@contextmanager
def acting_for(name: str) -> Iterator[None]:
    """Carry out what a user asked for.

    >>> with acting_for("operator"):
    ...     caller()
    'operator'
    """
    token = _name.set(name)
    try:
        yield
    finally:
        _name.reset(token)
