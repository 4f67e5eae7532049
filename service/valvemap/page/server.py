"""The web server: uvicorn on a socket of our own, with connections that are counted and timed."""

import asyncio
import contextlib
import socket
import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import h11
import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

from valvemap.errors import ValvemapError
from valvemap.page.settings import PageSettings

_REQUEST_S = 10.0  # from connecting to the end of the first request's head
_KEEP_ALIVE_S = 15
_PING_S = 20.0  # a viewer that is gone without a word is noticed within twice that
_HEAD_BYTES = 16 * 1024
_MESSAGE_BYTES = 4 * 1024  # of a viewer; what a page sends has some 100 bytes
_FAREWELL_S = 2
_BACKLOG = 64


class PageError(ValvemapError):
    """The page cannot be served at its address."""


def open_socket(settings: PageSettings, *, or_any: bool = False) -> socket.socket:
    """Listen; where the port is taken and ``or_any``, on a free one.

    Raises
    ------
    PageError
    """
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    if sys.platform != "win32":  # there, it would share a port that is taken
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((settings.host, settings.port))
        listening.listen(_BACKLOG)
    except OSError as error:
        listening.close()
        if or_any and settings.port:
            return open_socket(replace(settings, port=0))
        reason = (error.strerror or str(error)).lower()
        raise PageError(f"{settings.host}:{settings.port}: {reason}") from None
    return listening


def url_of(settings: PageSettings, listening: socket.socket) -> str:
    """Where a browser finds the page."""
    host, port = listening.getsockname()[:2]
    shown = f"[{host}]" if ":" in host else host
    return f"{'https' if settings.is_encrypted else 'http'}://{shown}:{port}"


async def serve(
    app: ASGIApp, settings: PageSettings, listening: socket.socket, stop: asyncio.Event
) -> None:
    """Serve until ``stop`` is set."""
    config = uvicorn.Config(
        app,
        http=_bounded_protocol(settings.connections),
        ws="websockets-sansio",
        ws_max_size=_MESSAGE_BYTES,
        ws_max_queue=8,
        ws_ping_interval=_PING_S,
        ws_ping_timeout=_PING_S,
        ws_per_message_deflate=False,
        h11_max_incomplete_event_size=_HEAD_BYTES,
        timeout_keep_alive=_KEEP_ALIVE_S,
        timeout_graceful_shutdown=_FAREWELL_S,
        lifespan="off",
        access_log=False,
        log_config=None,
        server_header=False,
        proxy_headers=False,
        ssl_certfile=settings.certificate,
        ssl_keyfile=None if settings.key is None else str(settings.key),
    )
    server = _Server(config)
    serving = asyncio.create_task(server.serve(sockets=[listening]))
    stopped = asyncio.create_task(stop.wait())
    try:
        await asyncio.wait({serving, stopped}, return_when=asyncio.FIRST_COMPLETED)
    finally:
        server.should_exit = True
        stopped.cancel()
        await serving


class _Server(uvicorn.Server):
    """Leaves signals to whoever started it."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


def _bounded_protocol(most: int) -> type[H11Protocol]:
    """HTTP connections: so many at once, and none that says nothing."""
    open_: set[object] = set()

    class Bounded(H11Protocol):
        _patience: asyncio.TimerHandle | None = None

        def connection_made(self, transport: Any) -> None:  # noqa: ANN401 - asyncio's
            if len(open_) >= most:
                transport.abort()
                return
            open_.add(self)
            super().connection_made(transport)
            self._patience = self.loop.call_later(_REQUEST_S, self._look)

        def connection_lost(self, exc: Exception | None) -> None:
            open_.discard(self)
            if self._patience is not None:
                self._patience.cancel()
                super().connection_lost(exc)

        def handle_websocket_upgrade(self, event: h11.Request) -> None:
            super().handle_websocket_upgrade(event)
            open_.discard(self)  # from now on a viewer, and counted there
            if self._patience is not None:
                self._patience.cancel()

        def _look(self) -> None:
            if self.cycle is None and not self.transport.is_closing():
                self.transport.abort()

    return Bounded
