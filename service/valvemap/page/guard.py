"""Checks of every request: host, origin, rate, size. Security headers of every response."""

from collections import Counter
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from valvemap.page.rates import Buckets
from valvemap.page.settings import PageSettings

REASONS = _HOST, _ORIGIN, _RATE, _SIZE = "host", "origin", "rate", "size"
_SAFE_METHODS = frozenset({"GET", "HEAD"})
_FORBIDDEN, _TOO_LARGE, _TOO_MANY, _MISDIRECTED = 403, 413, 429, 421
_LONGEST_PATH = 200

# Inline styles are allowed, since Plotly inserts them; scripts come from this origin only.
_POLICY = (
    "default-src 'none'; "
    "script-src 'self'; "
    "style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; "
    "connect-src 'self'; "
    "font-src 'self'; "
    "manifest-src 'self'; "
    "base-uri 'none'; "
    "form-action 'self'; "
    "frame-ancestors 'none'"
)
_HEADERS = {
    "Content-Security-Policy": _POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=()",
}


class Guard:
    """ASGI middleware.

    Parameters
    ----------
    inner
        The application behind it.
    settings
        Allowed host names, rates and sizes.
    """

    def __init__(self, inner: ASGIApp, settings: PageSettings) -> None:
        self._inner = inner
        self._settings = settings
        self._buckets = Buckets(settings.requests_per_s, settings.request_burst)
        self.refusals: Counter[str] = Counter()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse the request or pass it to the application."""
        if scope["type"] not in {"http", "websocket"}:
            await self._inner(scope, receive, send)
            return
        refusal = self._refusal(scope)
        if refusal is not None:
            reason, status = refusal
            self.refusals[reason] += 1
            await _refuse(scope, send, status)
            return

        async def answer(message: Message) -> None:
            if message["type"] in {"http.response.start", "websocket.accept"}:
                headers = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    headers.setdefault(name, value)
                if self._settings.is_encrypted:
                    headers.setdefault("Strict-Transport-Security", "max-age=31536000")
            await send(message)

        await self._inner(scope, receive, answer)

    def _refusal(self, scope: Scope) -> tuple[str, int] | None:
        headers = Headers(scope=scope)
        hosts = headers.getlist("host")
        if len(hosts) != 1 or not self._settings.accepts(_name(hosts[0])):
            return _HOST, _MISDIRECTED
        if not self._buckets.take(scope["client"][0] if scope["client"] else ""):
            return _RATE, _TOO_MANY
        acts = scope["type"] == "websocket" or scope["method"] not in _SAFE_METHODS
        if acts and not self._is_own(headers.getlist("origin"), hosts[0]):
            return _ORIGIN, _FORBIDDEN
        length = headers.get("content-length", "0")
        unbounded = "transfer-encoding" in headers
        if unbounded or not length.isdigit() or int(length) > self._settings.body_bytes:
            return _SIZE, _TOO_LARGE
        return (_SIZE, _TOO_LARGE) if len(scope["path"]) > _LONGEST_PATH else None

    def _is_own(self, origins: list[str], host: str) -> bool:
        """Whether the request's origin is this page."""
        if len(origins) != 1:
            return False
        scheme = "https" if self._settings.is_encrypted else "http"
        parts = urlsplit(origins[0])
        return (parts.scheme, parts.netloc.lower()) == (scheme, host.lower())


def _name(host: str) -> str:
    """The name in a Host header, without its port.

    >>> _name("LOCALHOST:8080"), _name("[::1]:8080")
    ('localhost', '[::1]')
    """
    lowered = host.lower()
    if lowered.startswith("["):
        return lowered.partition("]")[0] + "]"
    return lowered.partition(":")[0]


async def _refuse(scope: Scope, send: Send, status: int) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": ""})
        return
    headers = [(b"content-type", b"text/plain"), (b"connection", b"close")]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": b"refused\n"})
