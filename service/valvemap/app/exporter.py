"""Serves a program's metrics for Prometheus, from a separate thread.

The server is the page's: its door admits connections, its guard checks requests. It only reads,
so that a flood of requests does not delay the program, except for its share of the processor.
"""

import asyncio
import math
import threading
from collections.abc import Iterator
from typing import Final, Self

import structlog
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

from valvemap.app.metrics_address import MetricsAddress, Points
from valvemap.clock import Clock, SystemClock
from valvemap.page.door import Door
from valvemap.page.exposition import CONTENT_TYPE, build_point, exposition, refusals
from valvemap.page.guard import Guard
from valvemap.page.server import open_socket, serve, url_of
from valvemap.page.settings import PageSettings
from valvemap.vocabulary.series import EXPORTER_REFUSED, Point

_EVERY_S: Final = 1.0  # s; shortest interval between two computations of the metrics
_FAREWELL_S: Final = 5.0  # s; longest wait for the thread's end

log = structlog.get_logger(__name__)


class Exporter:
    """Answers ``/metrics`` and ``/livez``; a context manager.

    Parameters
    ----------
    address
        Where to listen.
    points
        Returns the program's metrics; called in the exporter's thread, at most once a second.
    clock
        The system clock if None.

    Raises
    ------
    PageError
        if the address cannot be used.
    """

    def __init__(self, address: MetricsAddress, points: Points, clock: Clock | None = None) -> None:
        self._settings = _settings(address)
        self._points = points
        self._clock = clock or SystemClock()
        self._listening = open_socket(self._settings)
        self.url = f"{url_of(self._settings, self._listening)}/metrics"
        self._text, self._computed = b"", -math.inf
        routes = [Route("/metrics", self._metrics), Route("/livez", self._livez)]
        self._guard = Guard(Starlette(routes=routes), self._settings)
        self._door = Door(self._settings, self._clock)
        self._loop = asyncio.new_event_loop()
        self._stop = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="metrics", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        log.info("metrics served", url=self.url)
        return self

    def __exit__(self, *_error: object) -> None:
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(_FAREWELL_S)

    def _run(self) -> None:
        serving = serve(self._guard, self._settings, self._listening, self._stop, self._door)
        try:
            self._loop.run_until_complete(serving)
        finally:
            self._listening.close()
            self._loop.close()

    async def _metrics(self, _request: Request) -> Response:
        now = self._clock.monotonic()
        if now - self._computed >= _EVERY_S:
            try:
                self._text = exposition(self._all_points())
            except Exception as error:  # noqa: BLE001 - bulkhead: the next request may succeed
                log.warning("metrics cannot be computed", reason=f"{type(error).__name__}: {error}")
                return PlainTextResponse("metrics cannot be computed\n", 503)
            self._computed = now
        return Response(self._text, media_type=CONTENT_TYPE)

    async def _livez(self, _request: Request) -> Response:
        return PlainTextResponse("alive\n")

    def _all_points(self) -> Iterator[Point]:
        yield build_point()
        yield from self._points()
        for why, count in refusals(self._guard, self._door).items():
            yield Point(EXPORTER_REFUSED, count, (why,))


def _settings(address: MetricsAddress) -> PageSettings:
    """Return the limits of the server: those of a few Prometheus servers."""
    return PageSettings(
        address.host,
        address.port,
        address.host_names,
        takes_addresses=True,  # Prometheus finds replicas by their addresses
        connections=20,
        connections_of_address=10,
        connections_per_s=50,
        requests_per_s=5.0,
        request_burst=30.0,
    )
