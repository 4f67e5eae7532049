"""Logging of a command: one line for each event, on the error stream."""

import logging
import sys
import traceback
from typing import Any, Literal

from valvemap.cli.without import without

with without("rich"):  # tracebacks in colour would take 2.5 % of the start
    import structlog

from guarded_opcua.logs import IS_ESCAPED
from valvemap.config.logs import LogConfig
from valvemap.foreign_text import LINE, printable

_OF_STRUCTLOG = ("_record", "_from_structlog", "exc_info", "positional_args")


def set_up_logs(config: LogConfig | None = None) -> None:
    """Format our events and those of the libraries alike."""
    config = config or LogConfig()
    shared: list[structlog.typing.Processor] = [
        structlog.stdlib.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
    ]
    structlog.configure(
        processors=[*shared, structlog.stdlib.ProcessorFormatter.wrap_for_formatter],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.make_filtering_bound_logger(_level(config.level)),
    )
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=shared,
            processors=[
                _in_one_line,
                _as_lines,
                structlog.stdlib.ProcessorFormatter.remove_processors_meta,
                structlog.processors.JSONRenderer()
                if config.format == "json"
                else structlog.dev.ConsoleRenderer(colors=sys.stderr.isatty()),
            ],
        )
    )
    root = logging.getLogger()
    root.handlers = [handler]
    root.setLevel(_level(config.level))


def _in_one_line(
    _logger: Any,  # noqa: ANN401 - structlog's signature
    _method: str,
    event: structlog.typing.EventDict,
) -> structlog.typing.EventDict:
    """Escape line breaks in values, so that external text cannot forge a log line."""
    if getattr(event.get("_record"), IS_ESCAPED, False):
        return event
    shown = {key: _shown(value) for key, value in event.items() if key not in _OF_STRUCTLOG}
    return shown | {key: event[key] for key in _OF_STRUCTLOG if key in event}


def _shown(value: object) -> object:
    """Shorten texts to one line, and escape unprintable characters."""
    match value:
        case str():
            return printable(value, LINE)
        case None | bool() | int() | float():
            return value
        case dict():
            return {printable(str(key)): _shown(inner) for key, inner in value.items()}
        case list() | tuple() | set() | frozenset():
            return [_shown(inner) for inner in value]
        case _:
            return printable(str(value), LINE)


def _as_lines(
    _logger: Any,  # noqa: ANN401 - structlog's signature
    _method: str,
    event: structlog.typing.EventDict,
) -> structlog.typing.EventDict:
    """Format an exception as indented lines, distinct from log lines."""
    failed = event.pop("exc_info", None)
    if failed is True:
        failed = sys.exc_info()
    if isinstance(failed, BaseException):
        failed = type(failed), failed, failed.__traceback__
    if failed and failed[0] is not None:
        lines = "".join(traceback.format_exception(*failed)).splitlines()
        event["exception"] = "\n".join(f"    {printable(line, LINE)}" for line in lines)
    return event


def _level(name: Literal["debug", "info", "warning", "error"]) -> int:
    return logging.getLevelNamesMapping()[name.upper()]
