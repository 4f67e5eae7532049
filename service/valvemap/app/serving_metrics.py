"""Serves a program's metrics while it runs, if it has an address; else no server is loaded."""

from collections.abc import Iterator
from contextlib import contextmanager

from valvemap.app.metrics_address import MetricsAddress, Points
from valvemap.errors import ConfigurationError


@contextmanager
def metrics_served(address: MetricsAddress | None, points: Points) -> Iterator[None]:
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
