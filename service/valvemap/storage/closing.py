"""A base class of files that are closed at the end of their ``with`` block."""

from types import TracebackType
from typing import Self


class Closing:
    """A context manager that calls ``close``, which is safe to call twice."""

    def close(self) -> None:
        """Close it."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
