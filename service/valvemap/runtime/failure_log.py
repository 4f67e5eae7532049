"""Logging of a lane's failure, once, with its traceback."""

import structlog

from valvemap.pipeline.lane_failures import LaneFailure

log = structlog.get_logger(__name__)


def log_failure(failure: LaneFailure) -> None:
    """Log why a lane stopped, and how to restart it."""
    log.error(
        "lane failed",
        valve=failure.valve,
        why=failure.reason,
        remedy="Reset starts it again",
        exc_info=failure.error,
    )
