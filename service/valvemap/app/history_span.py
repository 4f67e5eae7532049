"""For how long the configured size of the history lasts, estimated or measured."""

from typing import Final

from valvemap.config.models import Config, ValveConfig
from valvemap.vocabulary.quantities import HISTORY_QUANTITIES
from valvemap.vocabulary.signals import PUBLISHED

DAY_S: Final = 86_400.0
_VALUE: Final = 8  # bytes
_OF_ROW: Final = 5  # bytes; packed time and status, and the tables' own share


def span_in_words(config: Config, measured_bytes_per_s: float = 0.0) -> str:
    """Return how long the size lasts; by the estimate, unless the rate was measured.

    >>> span_in_words(Config.model_validate({"history": {"file": "h", "most_mb": 2000}}))
    '2,000 MB last about 11 days at one sample per publishing interval; keep_days = 7'
    """
    given = config.history
    rate = measured_bytes_per_s or sum(_bytes_per_s(config, valve) for valve in config.valves)
    days = given.most_mb * 1e6 / rate / DAY_S
    how = "as measured" if measured_bytes_per_s else "at one sample per publishing interval"
    short = "" if days >= given.keep_days else ": the oldest rows are deleted earlier"
    size, keep = f"{given.most_mb:,} MB", f"keep_days = {given.keep_days:g}"
    return f"{size} last about {days:.2g} days {how}; {keep}{short}"


def _bytes_per_s(config: Config, valve: ValveConfig) -> float:
    """Return the bytes per s if every signal changes once per publishing interval."""
    per_s = 1e3 / config.source_of(valve).publishing_interval_ms
    results = len(valve.estimators) * (_VALUE * len(HISTORY_QUANTITIES) + _OF_ROW)
    return per_s * (_VALUE * len(PUBLISHED) + _OF_ROW + results + _VALUE + _OF_ROW)
