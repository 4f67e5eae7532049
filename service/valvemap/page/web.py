"""The page as a web application: static files, one WebSocket, log-in, health, metrics."""

import asyncio
import json
import os
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, HTTPConnection, Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket

from valvemap.clock import Clock
from valvemap.errors import SourceLost, SourceRejected, ValvemapError
from valvemap.page.commands import carry_out, may_carry_out
from valvemap.page.door import Door
from valvemap.page.exposition import CONTENT_TYPE
from valvemap.page.guard import Guard
from valvemap.page.log_ins import Clients, LogIns
from valvemap.page.metrics import Metrics
from valvemap.page.observer import Link, Observer
from valvemap.page.ports import Client
from valvemap.page.settings import PageSettings
from valvemap.page.viewers import Viewers

STATIC = Path(__file__).parent / "static"
_COOKIE = "valvemap"
_BODY_S = 5.0  # s; timeout of a request's body
_PIECE_BYTES = 65_536  # bytes; chunk of a file


class Page:
    """All parts of one page process.

    Parameters
    ----------
    client
        The page's own client of the service.
    clients
        Makes the clients of a user at log-in.
    settings
        Address, access and limits.
    clock
        Time source.
    rig
        The URL of a demo's rig; None without one.
    past
        A second client of the service, for its history; None: ``client`` reads it, too.
    """

    def __init__(
        self,
        client: Client,
        clients: Clients,
        settings: PageSettings,
        clock: Clock,
        rig: str | None = None,
        past: Client | None = None,
    ) -> None:
        self.settings = settings
        self.door = Door(settings, clock)
        self.viewers = Viewers(settings.viewers, settings.viewers_of_address, clock)
        self.observer = Observer(
            client,
            clock,
            lambda: self.viewers.wanted(self.observer.places),
            self.viewers.wake,
            past,
        )
        self.log_ins = LogIns(clients, settings, clock)
        self._has_rig = rig is not None
        self.guard = Guard(self._noting_log_ins(self._application()), settings)
        self._metrics = Metrics(self.observer, self.viewers, self.guard, self.log_ins, self.door)

    def _noting_log_ins(self, application: ASGIApp) -> ASGIApp:
        """Wrap an application to keep the connections of logged-in users."""

        async def noting(scope: Scope, receive: Receive, send: Send) -> None:
            secret = HTTPConnection(scope).cookies.get(_COOKIE)
            self.door.note_log_in(scope, is_logged_in=self.log_ins.holds(secret))
            await application(scope, receive, send)

        return noting

    def _application(self) -> Starlette:
        return Starlette(
            routes=[
                WebSocketRoute("/live", self._live),
                Route("/livez", self._livez),
                Route("/readyz", self._readyz),
                Route("/metrics", self._show_metrics),
                Route("/user", self._user),
                Route("/log-in", self._log_in, methods=["POST"]),
                Route("/log-out", self._log_out, methods=["POST"]),
                Route("/command", self._command, methods=["POST"]),
                Route("/may", self._may, methods=["POST"]),
                Mount("/", _Files(STATIC)),
            ]
        )

    async def _live(self, socket: WebSocket) -> None:
        await self.viewers.serve(socket, self.observer)

    async def _livez(self, _request: Request) -> Response:
        return PlainTextResponse("alive\n")

    async def _readyz(self, _request: Request) -> Response:
        if self.observer.link is Link.UP:
            return PlainTextResponse("ready\n")
        return PlainTextResponse(f"{self.observer.link}: {self.observer.link_text}\n", 503)

    async def _show_metrics(self, _request: Request) -> Response:
        await self.observer.look_at_figures()
        return Response(self._metrics.exposition(), media_type=CONTENT_TYPE)

    async def _user(self, request: Request) -> Response:
        """Return the logged-in user and the available features."""
        log_in = self.log_ins.find(request.cookies.get(_COOKIE))
        return _answer(
            user=log_in.user if log_in else None,
            mayLogIn=self.settings.may_log_in,
            hasRig=self._has_rig,
        )

    async def _log_in(self, request: Request) -> Response:
        if not self.settings.may_log_in:
            return _answer(403, error="a password would travel in the clear: https is needed")
        match await _body(request):
            case {"user": str() as user, "password": str() as password} if user and password:
                try:
                    host = request.client.host if request.client else ""
                    secret = await self.log_ins.log_in(user, password, host)
                except SourceLost as error:
                    words = f"the service does not answer: try again in a moment ({error})"
                    return _answer(503, error=words)
                except ValvemapError as error:
                    return _answer(403, error=str(error))
            case _:
                return _answer(400, error="user and password are needed")
        answer = _answer(user=user)
        answer.set_cookie(
            _COOKIE, secret, httponly=True, samesite="strict", secure=self.settings.is_encrypted
        )
        return answer

    async def _log_out(self, request: Request) -> Response:
        await self.log_ins.log_out(request.cookies.get(_COOKIE))
        answer = _answer(user=None)
        answer.delete_cookie(_COOKIE, httponly=True, samesite="strict")
        return answer

    async def _command(self, request: Request) -> Response:
        log_in = self.log_ins.find(request.cookies.get(_COOKIE))
        if log_in is None:
            return _answer(401, error="log in first")
        try:
            await carry_out(log_in, await _body(request))
        except ValvemapError as error:
            return _answer(409, error=str(error))
        return _answer()

    async def _may(self, request: Request) -> Response:
        """Say whether the user may carry out a command; nothing is written."""
        log_in = self.log_ins.find(request.cookies.get(_COOKIE))
        if log_in is None:
            return _answer(401, error="log in first")
        try:
            return _answer(may=await may_carry_out(log_in, await _body(request)))
        except SourceRejected as error:  # the user may have been removed while the service was away
            await self.log_ins.log_out(request.cookies.get(_COOKIE))
            return _answer(401, error=str(error))
        except ValvemapError as error:
            return _answer(409, error=str(error))


class _Files(StaticFiles):
    """The page's files, cached in memory: a slow reader holds no descriptor.

    Browsers revalidate them, so that they reload them after an update only.
    """

    def __init__(self, directory: Path) -> None:
        super().__init__(directory=directory, html=True)
        self._kept: dict[str, tuple[int, bytes]] = {}  # path: modification time, content

    def file_response(
        self,
        full_path: str | os.PathLike[str],
        stat_result: os.stat_result,
        scope: Scope,
        status_code: int = 200,
    ) -> Response:
        response = super().file_response(full_path, stat_result, scope, status_code)
        response.headers["Cache-Control"] = "no-cache"
        if not isinstance(response, FileResponse):  # 304 Not Modified
            return response
        written, content = self._kept.get(str(full_path), (-1, b""))
        if written != stat_result.st_mtime_ns:
            content = Path(full_path).read_bytes()
            self._kept[str(full_path)] = (stat_result.st_mtime_ns, content)
        return _Kept(content, response)


class _Kept(Response):
    """A cached file, sent in chunks as the client reads."""

    def __init__(self, content: bytes, as_file: FileResponse) -> None:
        super().__init__(status_code=as_file.status_code)
        self.raw_headers = [
            (name, value) for name, value in as_file.raw_headers if name != b"accept-ranges"
        ]
        self._content = memoryview(content)

    async def __call__(self, _scope: Scope, _receive: Receive, send: Send) -> None:
        await send(
            {
                "type": "http.response.start",
                "status": self.status_code,
                "headers": self.raw_headers,
            }
        )
        for at in range(0, len(self._content), _PIECE_BYTES):
            piece = bytes(self._content[at : at + _PIECE_BYTES])
            await send({"type": "http.response.body", "body": piece, "more_body": True})
        await send({"type": "http.response.body", "body": b""})


async def _body(request: Request) -> dict[str, Any]:
    """Return a request's JSON object; an empty one if it is invalid or times out."""
    try:
        async with asyncio.timeout(_BODY_S):
            body = json.loads(await request.body())
    except (ValueError, RecursionError, TimeoutError, ClientDisconnect):
        return {}
    return body if isinstance(body, dict) else {}


def _answer(status: int = 200, **content: Any) -> JSONResponse:  # noqa: ANN401 - any JSON
    return JSONResponse(content, status, headers={"Cache-Control": "no-store"})
