"""Section ``[log]``: the log's level and format."""

from typing import Literal

from pydantic import Field

from valvemap.config.sections import Section


class LogConfig(Section):
    """The log of the running service."""

    level: Literal["debug", "info", "warning", "error"] = Field(
        "info", description="least severe event that is logged"
    )
    format: Literal["console", "json"] = Field(
        "console", description="console: for people; json: an object a line"
    )
