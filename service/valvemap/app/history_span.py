"""For how long the configured size of the history lasts, estimated or measured."""

from typing import Final, NamedTuple

from valvemap.config.models import Config
from valvemap.storage.history_cells import WIDTHS
from valvemap.storage.history_spans import LEAST_RESULTS, LEAST_ROWS
from valvemap.vocabulary.quantities import HISTORY_QUANTITIES, Kind
from valvemap.vocabulary.signals import PUBLISHED

DAY_S: Final = 86_400.0
_SIGNAL: Final = 1.3  # bytes per value; packed, of transmitters with 2 decimals
_RESULT: Final = 5.2  # bytes per value; packed
_CELL_OF_SIGNAL: Final = 6.0  # bytes per cell and signal, packed
_CELL_OF_RESULT: Final = 20.0  # bytes per cell and result, packed
_NUMBERS: Final = sum(q.kind is Kind.NUMBER for q in HISTORY_QUANTITIES)  # codes take no room
_PAGES: Final = 1.1  # of the file per byte of a column


class _Rates(NamedTuple):
    """Bytes per day."""

    signals: float
    results: float
    fine: float
    coarse: float


class _Days(NamedTuple):
    signals: float
    results: float
    fine: float
    coarse: float


def span_in_words(config: Config, measured_bytes_per_s: float = 0.0) -> str:
    """Return how long the size lasts; by the estimate, unless the rate was measured.

    >>> span_in_words(Config.model_validate({"history": {"file": "h"}}))
    '2,000 MB hold signals for 7 days, results for 7 days, summaries of 10 s for 7 days, of 5 min \
for 30 days, at one sample per publishing interval'
    """
    given, rates = config.history, _estimated(config)
    how = "at one sample per publishing interval"
    if measured_bytes_per_s:
        how = "as measured"
        scale = measured_bytes_per_s * DAY_S * _PAGES / (rates.signals + rates.results)
        rates = rates._replace(signals=rates.signals * scale, results=rates.results * scale)
    wanted, days = _wanted(config), _days(config, rates)
    short = any(one < 0.99 * other for one, other in zip(days, wanted, strict=True))
    limit = ": most_mb deletes the oldest earlier than configured" if short else ""
    return (
        f"{given.most_mb:,} MB hold signals for {days.signals:.2g} days, "
        f"results for {days.results:.2g} days, summaries of 10 s for {days.fine:.2g} days, "
        f"of 5 min for {days.coarse:.2g} days, {how}{limit}"
    )


def _wanted(config: Config) -> _Days:
    given = config.history
    results = given.keep_days if given.results_days is None else given.results_days
    trend = max(given.trend_days, given.keep_days)
    return _Days(given.keep_days, min(results, given.keep_days), given.keep_days, trend)


def _days(config: Config, rates: _Rates) -> _Days:
    """Return for how long each lasts, as `storage.history_spans` deletes them."""
    wanted, most = _wanted(config), config.history.most_mb * 1e6
    tiers = rates.fine * wanted.fine + rates.coarse * wanted.coarse
    room = max(most - tiers, LEAST_ROWS * most)
    least = min(rates.results * wanted.results, LEAST_RESULTS * most)
    signals = min(wanted.signals, (room - least) / rates.signals)
    results = min(wanted.results, (room - signals * rates.signals) / max(rates.results, 1.0))
    left = most - signals * rates.signals - results * rates.results
    fine = min(wanted.fine, max(left - rates.coarse * wanted.coarse, 0.0) / rates.fine)
    coarse = min(wanted.coarse, (left - fine * rates.fine) / rates.coarse)
    return _Days(signals, results, fine, coarse)


def _estimated(config: Config) -> _Rates:
    """Return the rates if every signal changes once per publishing interval."""
    signals = results = fine = coarse = 0.0
    for valve in config.valves:
        per_day = DAY_S * 1e3 / config.source_of(valve).publishing_interval_ms
        values = len(valve.estimators) * _NUMBERS
        signals += per_day * _SIGNAL * len(PUBLISHED)
        results += per_day * _RESULT * values
        cell = _CELL_OF_SIGNAL * len(PUBLISHED) + _CELL_OF_RESULT * values  # bytes
        fine += cell * DAY_S / (WIDTHS[0] * 1e-9)
        coarse += cell * DAY_S / (WIDTHS[1] * 1e-9)
    return _Rates(*(_PAGES * max(rate, 1.0) for rate in (signals, results, fine, coarse)))
