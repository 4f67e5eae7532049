"""Files that are closed where their ``with`` ends."""

from types import TracebackType
from typing import Self


class Closing:
    """What has a ``close`` that is safe to call twice."""

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
