"""Logging of failures at one valve, once each, with the traceback."""

from collections.abc import Mapping

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


def log_left_out(valve: str, error: Exception) -> None:
    """Log why a valve's changes are not aligned any more, where no lanes can be reset."""
    log.error(
        "alignment failed, the valve is left out",
        valve=valve,
        why=f"{type(error).__name__}: {error}",
        remedy="a restart of the source, or of this program, starts it again",
        exc_info=error,
    )


def log_missing(samples: Mapping[str, int]) -> None:
    """Log the samples missing of each valve that is left out, if there is one."""
    if samples:
        log.warning("valves are left out, their samples are missing", samples=dict(samples))
