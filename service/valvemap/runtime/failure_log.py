"""A lane's failure in the log: once, with its traceback."""

import structlog

from valvemap.pipeline.lane_failures import LaneFailure

log = structlog.get_logger(__name__)


def log_failure(failure: LaneFailure) -> None:
    """Log why a lane stopped, and what starts it again."""
    log.error(
        "lane failed",
        valve=failure.valve,
        why=failure.reason,
        remedy="Reset starts it again",
        exc_info=failure.error,
    )
