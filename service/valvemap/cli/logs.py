"""What is logged while a command runs: one line an event, on the error stream."""

import logging
import sys
from typing import Any, Literal

from valvemap.cli.without import without

with without("rich"):  # for tracebacks in colour: a fortieth of a start
    import structlog

from guarded_opcua.logs import IS_ESCAPED, escaped
from valvemap.config.logs import LogConfig

_QUIET = ("asyncua", "numba", "matplotlib")


def set_up_logs(config: LogConfig | None = None) -> None:
    """Send our events and those of the libraries through one formatter."""
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
    for name in _QUIET:
        logging.getLogger(name).setLevel(logging.ERROR)


def _in_one_line(
    _logger: Any,  # noqa: ANN401 - structlog's signature
    _method: str,
    event: structlog.typing.EventDict,
) -> structlog.typing.EventDict:
    """Escape what others may have said, so that it looks like no further line."""
    if getattr(event.get("_record"), IS_ESCAPED, False):
        return event
    return {
        key: escaped(value) if isinstance(value, str) else value for key, value in event.items()
    }


def _level(name: Literal["debug", "info", "warning", "error"]) -> int:
    return logging.getLevelNamesMapping()[name.upper()]
