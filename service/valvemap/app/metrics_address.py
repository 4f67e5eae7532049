"""Where a program serves its metrics, and what computes them."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from valvemap.vocabulary.series import Point

Points = Callable[[], Iterable[Point]]


@dataclass(frozen=True)
class MetricsAddress:
    """Address and port; ``host_names`` are accepted beside loopback's."""

    host: str
    port: int
    host_names: tuple[str, ...] = ()
