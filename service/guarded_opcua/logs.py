"""Loggers that peers can neither flood nor forge: rate-limited and escaped to one line a record."""

import logging
import traceback
from contextvars import ContextVar
from dataclasses import dataclass

AUDIT = "opcua.audit"  # name of the logger of user actions
WINDOW_S = 10.0
IS_ESCAPED = "is_escaped"  # attribute of a record that formatters need not escape again
_LINES, _AUDIT_LINES = 10, 200
_OF_ASYNCUA = (
    "asyncua.uaprotocol",
    "asyncua.ua.ua_binary",
    "asyncua.ua.uatypes",
    "asyncua.crypto.security_policies",
    "asyncua.crypto.uacrypto",
    "asyncua.server.address_space",
    "asyncua.server.history",
)


@dataclass
class _Kind:
    since: float
    lines: int = 0
    left_out: int = 0


class Bounded(logging.Filter):
    """Passes ``lines`` records of one message per window; reports the number suppressed.

    Records that pass are escaped, whatever formatter is used, since text from a peer may contain
    line breaks.

    >>> quiet = Bounded(lines=2)
    >>> [quiet.filter(logging.makeLogRecord({"msg": "refused %s"})) for _ in range(4)]
    [True, True, False, False]
    """

    def __init__(self, lines: int) -> None:
        super().__init__()
        self._lines = lines
        self._kinds: dict[str, _Kind] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether the record may pass."""
        now = record.created
        template = str(record.msg)
        kind = self._kinds.get(template)
        if kind is None:
            kind = self._kinds[template] = _Kind(now)
        if now - kind.since > WINDOW_S:
            left_out, kind.since, kind.lines, kind.left_out = kind.left_out, now, 0, 0
            if left_out:
                record.msg = f"{template} (and {left_out} more like it)"
        kind.lines += 1
        kind.left_out += kind.lines > self._lines
        if kind.lines > self._lines:
            return False
        _escape(record)
        return True


def escaped(text: str) -> str:
    r"""Return a text in one printable line: control characters and line breaks as escapes.

    >>> print(escaped("peer\n2026-11-22 [info] let in"))
    peer\n2026-11-22 [info] let in
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def bounded_logger(name: str) -> logging.Logger:
    """Return the logger of that name, bounded."""
    return _bound(name, _LINES)


def audit_logger() -> logging.Logger:
    """Return the logger of user actions: sessions, writes, calls, refusals."""
    return _bound(AUDIT, _AUDIT_LINES)


def bound_asyncua() -> None:
    """Rate-limit asyncua's log records in this task, which serves a peer, and in no other."""
    _serves_a_peer.set(True)
    for name in _OF_ASYNCUA:
        logger = logging.getLogger(name)
        if not any(isinstance(known, _WhileServing) for known in logger.filters):
            logger.addFilter(_WhileServing(_LINES))


class _WhileServing(Bounded):
    """Rate-limits only tasks that serve a peer; other tasks keep all of asyncua's records."""

    def filter(self, record: logging.LogRecord) -> bool:
        return not _serves_a_peer.get() or super().filter(record)


_serves_a_peer: ContextVar[bool] = ContextVar("serves_a_peer", default=False)


def _escape(record: logging.LogRecord) -> None:
    record.msg, record.args = escaped(record.getMessage()), None
    setattr(record, IS_ESCAPED, True)
    if record.exc_info and record.exc_info[0] is not None:
        # indented, so that no line of the traceback looks like a log record
        lines = "".join(traceback.format_exception(*record.exc_info)).splitlines()
        record.msg = "\n".join([record.msg, *(f"    {escaped(line)}" for line in lines)])
        record.exc_info = record.exc_text = None


def _bound(name: str, lines: int) -> logging.Logger:
    logger = logging.getLogger(name)
    if not any(isinstance(known, Bounded) for known in logger.filters):
        logger.addFilter(Bounded(lines))
    return logger
