"""The turn of a request, as those that answer it see it."""

from collections.abc import Awaitable
from typing import Protocol, TypeVar

T = TypeVar("T")


class Turn(Protocol):
    """The scheduled turn of the running request."""

    async def breathe(self) -> None:
        """Yield to other connections if this request has used its time slice."""

    async def outside(self, slow: Awaitable[T]) -> T:
        """Await a slow operation with the turn released."""
