"""Pauses between connection attempts, as a pure iterator: tests need no sleep."""

from collections.abc import Iterator
from itertools import chain, repeat, takewhile

CEILING_S = 5.0  # s; longest pause: a source that returns is reconnected within 9 s


def backoff(
    first_s: float = 0.5, factor: float = 2.0, ceiling_s: float = CEILING_S
) -> Iterator[float]:
    """Yield pauses in s, growing by ``factor`` up to ``ceiling_s``, without end.

    >>> from itertools import islice
    >>> list(islice(backoff(1.0, 2.0, 5.0), 5))
    [1.0, 2.0, 4.0, 5.0, 5.0]
    """

    def growing() -> Iterator[float]:
        pause = first_s
        while True:
            yield pause
            pause *= factor

    return chain(takewhile(lambda pause: pause < ceiling_s, growing()), repeat(ceiling_s))
