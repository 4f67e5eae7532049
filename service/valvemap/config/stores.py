"""The sections of states, history and recordings."""

from pathlib import Path

from pydantic import Field

from valvemap.config.sections import Section


class StateConfig(Section):
    """The states that survive a restart."""

    file: Path = Field(Path("data/state.sqlite"), description="SQLite file of the states")
    checkpoint_interval_s: float = Field(
        10.0, ge=0.1, le=86_400.0, description="interval at which states are saved"
    )


class HistoryConfig(Section):
    """The recorded signals and results, for trends."""

    file: Path | None = Field(
        None, description="SQLite file of the history; none: there is no history"
    )
    keep_days: float = Field(
        7.0,
        gt=0.0,
        le=3_650.0,
        description="age at which values, and their summaries of 10 s, are deleted, in days",
    )
    results_days: float | None = Field(
        None,
        gt=0.0,
        le=3_650.0,
        description="age at which values of results are deleted, in days; none: keep_days",
    )
    trend_days: float = Field(
        30.0,
        gt=0.0,
        le=3_650.0,
        description="age at which summaries of 5 min are deleted, in days; at least keep_days",
    )
    most_mb: int = Field(
        2_000,
        ge=10,
        le=1_000_000,
        description="size above which the oldest values are deleted, in MB; results first",
    )


class RecordingConfig(Section):
    """Columns of recordings that are not signals of a valve; if omitted, they are found by name."""

    time: str | None = Field(None, min_length=1, description="column of the times")
    valve: str | None = Field(None, min_length=1, description="column of the valves' names")
    quality: str | None = Field(None, min_length=1, description="column of the qualities")
