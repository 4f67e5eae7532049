"""Where a program serves its metrics, if it does; the server is imported only then."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from valvemap.errors import ConfigurationError
from valvemap.vocabulary.series import Point

Points = Callable[[], Iterable[Point]]


@dataclass(frozen=True)
class MetricsAddress:
    """Address and port; ``host_names`` are accepted beside loopback's."""

    host: str
    port: int
    host_names: tuple[str, ...] = ()


@contextmanager
def exported(address: MetricsAddress | None, points: Points) -> Iterator[None]:
    """Serve metrics inside the context, if there is an address.

    ``points`` is called in another thread, at most once a second.

    Raises
    ------
    ConfigurationError
        if a package is not installed.
    PageError
        if the address cannot be used.
    """
    if address is None:
        yield
        return
    try:
        from valvemap.app.exporter import Exporter  # noqa: PLC0415 - of an extra
    except ModuleNotFoundError as error:
        raise ConfigurationError(
            f"--metrics needs {error.name}: pip install 'valvemap[dashboard]'"
        ) from None
    with Exporter(address, points):
        yield
