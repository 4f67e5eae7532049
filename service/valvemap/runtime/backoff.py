"""How long to wait before the next try: a pure iterator, so that no test need sleep."""

from collections.abc import Iterator
from itertools import chain, repeat, takewhile

CEILING_S = 5.0  # a source that is back is heard within 9 s, however long it was away


def backoff(
    first_s: float = 0.5, factor: float = 2.0, ceiling_s: float = CEILING_S
) -> Iterator[float]:
    """Pauses in s, growing by ``factor`` up to ``ceiling_s``, for ever.

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
