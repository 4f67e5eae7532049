"""Newest results of all valves of a site, collected from the results topic. Pure."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from valvemap.kafka.result_blocks import ResultsBlock
from valvemap.model.samples import Codes, Floats, Times
from valvemap.model.survey import Survey
from valvemap.pipeline.alarm_results import AlarmReport, AlarmResults
from valvemap.pipeline.results import Results, Version
from valvemap.vocabulary.statuses import Quality

R = TypeVar("R")
_NO_REPORTS: Final[tuple[AlarmReport, ...]] = ()


@dataclass(frozen=True)
class _Row:
    """Row of a valve's newest results."""

    results: Results
    m: int


class Mirror:
    """The newest results of all valves of a site, by the site's valve numbers.

    Parameters
    ----------
    names
        Names of the valves, in the order of the site's configuration.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._numbers = {name: number for number, name in enumerate(names)}
        self._rows: dict[int, _Row] = {}
        self._maps: dict[int, Floats] = {}
        self._surveys: dict[tuple[int, str], Survey] = {}
        self.newest: Times = np.zeros(len(names), np.int64)

    def take(self, block: ResultsBlock) -> Results:
        """Store a block; return its results, completed with the newest tables and surveys.

        Results of valves that the site does not have are dropped.
        """
        names = [block.valves[valve] for valve in block.results.valves]
        known = np.array([name in self._numbers for name in names], np.bool_)
        found = rows_of(block.results, np.flatnonzero(known))
        valves = np.array([self._numbers[n] for n in names if n in self._numbers], np.int64)
        found = self._completed(replace(found, valves=valves))
        for m, valve in enumerate(valves.tolist()):
            self._rows[valve] = _Row(found, m)
        if found.signals is not None:
            self.newest[valves] = found.signals.t
        return found

    def forget(self, names: Sequence[str]) -> None:
        """Drop the results of the given valves: they cannot be shown."""
        for valve in (self._numbers[name] for name in names if name in self._numbers):
            self._rows.pop(valve, None)
            self._maps.pop(valve, None)
            self.newest[valve] = 0
            for key in [key for key in self._surveys if key[0] == valve]:
                del self._surveys[key]

    def again(self, valves: Sequence[int], at_best: int) -> Iterator[Results]:
        """Yield the newest results of the given valves, with quality limited to ``at_best``."""
        together: dict[int, tuple[Results, list[int]]] = {}
        for valve in valves:
            if valve in self._rows:
                row = self._rows[valve]
                together.setdefault(id(row.results), (row.results, []))[1].append(row.m)
        for results, rows in together.values():
            yield _at_best(rows_of(results, np.array(rows, np.int64)), at_best)

    def reports(self, valve: int) -> Sequence[AlarmReport]:
        """Return the states of a valve's alarms; empty before the first alarm."""
        row = self._rows.get(valve)
        if row is None or row.results.alarms is None:
            return _NO_REPORTS
        return row.results.alarms.reports(row.m)

    def baseline(self, valve: int) -> Version | None:
        """Return the approved map of a valve, from its newest results."""
        row = self._rows.get(valve)
        return None if row is None else row.results.baselines[row.m]

    def _completed(self, found: Results) -> Results:
        """Fill in the newest table and survey of each valve where the results have none."""
        maps, valves = list(found.inverse.map_U), found.valves.tolist()
        for m, valve in enumerate(valves):
            if maps[m].size:
                self._maps[valve] = maps[m]
            maps[m] = self._maps.get(valve, maps[m])
        estimators = {}
        for name, own in found.estimators.items():
            surveys = list(own.survey)
            for m, valve in enumerate(valves):
                newest = surveys[m]
                if newest is not None:
                    self._surveys[valve, name] = newest
                surveys[m] = self._surveys.get((valve, name))
            estimators[name] = replace(own, survey=surveys)
        return replace(found, estimators=estimators, inverse=replace(found.inverse, map_U=maps))


def rows_of(results: Results, rows: NDArray[np.int64]) -> Results:
    """Select rows of results."""
    alarms, signals = results.alarms, results.signals
    return replace(
        results,
        valves=results.valves[rows],
        estimators={name: _some(found, rows) for name, found in results.estimators.items()},
        inverse=_some(results.inverse, rows),
        counters=results.counters[rows],
        signals=None if signals is None else _some(signals, rows),
        waiting=_chosen(results.waiting, rows),
        timing=_chosen(results.timing, rows),
        baselines=_chosen(results.baselines, rows),
        recommended=_chosen(results.recommended, rows),
        findings=_chosen(results.findings, rows),
        alarms=None
        if alarms is None
        else AlarmResults(alarms.version[rows], lambda m: alarms.reports(int(rows[m]))),
    )


def _some(columns: R, rows: NDArray[np.int64]) -> R:
    """Select rows of a dataclass of columns."""
    chosen: Mapping[str, Any] = {
        f.name: _chosen(getattr(columns, f.name), rows)
        for f in fields(columns)  # type: ignore[arg-type]
    }
    return type(columns)(**chosen)


def _chosen(column: Any, rows: NDArray[np.int64]) -> Any:  # noqa: ANN401 - array or list
    if isinstance(column, np.ndarray):
        return column[rows]
    return [column[row] for row in rows.tolist()] if column else column


def _at_best(results: Results, quality: int) -> Results:
    def no_better(found: Codes) -> Codes:
        return np.maximum(found, np.uint8(quality))

    signals = results.signals
    old = np.ones(len(results.valves), np.bool_) if quality == Quality.UNCERTAIN else None
    return replace(
        results,
        estimators={
            name: replace(own, quality=no_better(own.quality), old=old)
            for name, own in results.estimators.items()
        },
        inverse=replace(results.inverse, quality=no_better(results.inverse.quality)),
        signals=None if signals is None else replace(signals, quality=no_better(signals.quality)),
    )
