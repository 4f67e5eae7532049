"""The web server: uvicorn on our own socket, with limits and timeouts for connections."""

import asyncio
import contextlib
import socket
import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import uvicorn
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from uvicorn.server import ServerState

from valvemap.errors import ValvemapError
from valvemap.page.door import PLACE, Door, Place, Step
from valvemap.page.rates import TokenBucket
from valvemap.page.settings import PageSettings

_KEEP_ALIVE_S = 15
_PING_S = 20.0  # s; a silent loss of a viewer is detected within twice that
_HEAD_BYTES = 16 * 1024
_MESSAGE_BYTES = 4 * 1024  # bytes; largest message of a viewer: a page sends some 100 bytes
_VIEWER_BYTES_PER_S, _VIEWER_BURST_BYTES = 8_192.0, 32_768.0  # a page sends some 2 kB a second
_MOST_FRAMES = 64  # frames of one message; browsers send one
_FAREWELL_S = 1
_BACKLOG = 4096  # connections that wait to be accepted: attackers must not fill the queue


class PageError(ValvemapError):
    """The page cannot be served at its address."""


def open_socket(settings: PageSettings, *, or_any: bool = False) -> socket.socket:
    """Listen on the configured port; with ``or_any``, on a free one if it is in use.

    Raises
    ------
    PageError
    """
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)  # for TCP_NODELAY
    if sys.platform != "win32":  # on Windows, SO_REUSEADDR would share a port in use
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
    """URL of the page."""
    host, port = listening.getsockname()[:2]
    shown = f"[{host}]" if ":" in host else host
    return f"{'https' if settings.is_encrypted else 'http'}://{shown}:{port}"


async def serve(
    app: ASGIApp, settings: PageSettings, listening: socket.socket, stop: asyncio.Event, door: Door
) -> None:
    """Serve until ``stop`` is set."""
    config = uvicorn.Config(
        _noting_steps(app),
        ws=_Live,
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
    server = _Server(config, door)
    serving = asyncio.create_task(server.serve(sockets=[listening]))
    stopped = asyncio.create_task(stop.wait())
    try:
        await asyncio.wait({serving, stopped}, return_when=asyncio.FIRST_COMPLETED)
    finally:
        server.should_exit = True
        stopped.cancel()
        await serving


class _Server(uvicorn.Server):
    """Takes connections from a door; leaves signals to the caller."""

    def __init__(self, config: uvicorn.Config, door: Door) -> None:
        super().__init__(config)
        self._door = door
        self._open: asyncio.Task[None] | None = None

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        (listening,) = sockets or []

        def protocol(place: Place) -> asyncio.Protocol:
            return _Http(place, self._door, self.config, self.server_state)

        self.servers = []  # asyncio's servers would start TLS before a refusal
        self._open = asyncio.create_task(self._door.open(listening, protocol, self.config.ssl))
        self.started = True

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        if self._open is not None:
            self._open.cancel()
            await asyncio.gather(self._open, return_exceptions=True)
        await super().shutdown(sockets)
        self._door.hang_up()
        await asyncio.sleep(0)  # let connections process their loss


class _Http(H11Protocol):
    """An HTTP connection; it keeps its place until it is lost."""

    def __init__(
        self, place: Place, door: Door, config: uvicorn.Config, state: ServerState
    ) -> None:
        super().__init__(config, state, {PLACE: place})
        self._place, self._door = place, door
        self.ws_protocol_class = partial(_Live, place=place, door=door)  # type: ignore[assignment]

    def connection_made(self, transport: Any) -> None:  # noqa: ANN401 - asyncio's
        self._place.transport = transport
        self._place.go_to(Step.SILENT)
        super().connection_made(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        self._door.leave(self._place)
        super().connection_lost(exc)


class _Live(WebSocketsSansIOProtocol):
    """A viewer's WebSocket; one that exceeds the rate of a page is closed."""

    def __init__(self, *arguments: Any, place: Place, door: Door, **more: Any) -> None:  # noqa: ANN401
        super().__init__(*arguments, **more)
        self._place, self._door = place, door
        self._may_send = TokenBucket(_VIEWER_BYTES_PER_S, _VIEWER_BURST_BYTES)

    def data_received(self, data: bytes) -> None:
        if self._may_send.take(len(data)) and len(self.frames) < _MOST_FRAMES:
            super().data_received(data)
        else:
            self.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        self._door.leave(self._place)
        super().connection_lost(exc)


def _noting_steps(app: ASGIApp) -> ASGIApp:
    """Wrap an application to record the step of each connection."""

    async def noting(scope: Scope, receive: Receive, send: Send) -> None:
        place: Place = scope["state"][PLACE]
        is_viewer = scope["type"] == "websocket"
        place.go_to(Step.VIEWING if is_viewer else Step.ANSWERING)
        try:
            await app(scope, receive, send)
        finally:
            place.go_to(Step.CLOSING if is_viewer else Step.WAITING)

    return noting
