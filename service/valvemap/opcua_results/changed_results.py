"""Results that change rarely or are large: published only when they change."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from valvemap.model.samples import Times
from valvemap.opcua_results.dynamics_nodes import dynamics_values
from valvemap.opcua_results.information_model import (
    BASELINE,
    BUILDS_ON,
    DIAGNOSTICS,
    DYNAMICS,
    FEED_FORWARD_STATUS,
    FINDING_CODES,
    FINDING_PROBABILITIES,
    FINDINGS,
    INVERSE,
    RECOMMENDED,
    RECOMMENDED_REASON,
    TIMING,
    WAITING,
)
from valvemap.opcua_results.result_codes import estimator_own_words, inverse_codes
from valvemap.opcua_results.result_values import (
    Column,
    Shown,
    baseline_values,
    discovery_values,
    feed_forward_values,
    lag_values,
    map_value,
    survey_values,
)
from valvemap.opcua_results.valve_variables import counter_name
from valvemap.pipeline.results import EstimatorResults, Results


class ChangedResults:
    """Detects changes against the results last published for each valve.

    Parameters
    ----------
    valves, counters
        Number of valves and of counters per valve.
    """

    def __init__(self, valves: int, counters: int) -> None:
        self._counts = np.full((valves, counters), -1, np.int64)
        self._counted = np.zeros((valves, counters), np.int64)  # when it last grew, UTC ns
        self._said: dict[tuple[int, str], tuple[Any, ...]] = {}

    def counts(self, results: Results, due: NDArray[np.bool_], now: int) -> Iterator[Column]:
        """Changed counters of the valves that are due; stamped when the value was first seen."""
        counters = results.counters[due]
        where = results.valves[due, None], np.arange(counters.shape[1])
        grown = counters != self._counts[where]
        t = np.where(grown, now, self._counted[where])
        self._counts[where], self._counted[where] = counters, t
        good = np.full(len(counters), ua.StatusCodes.Good, np.uint32)
        for k in np.flatnonzero(grown.any(axis=0)):
            yield Column(counter_name(results.counter_names[k]), counters[:, k], good, t[:, k])

    def values(self, results: Results, now: int) -> Iterator[tuple[int, Shown]]:
        """New maps, surveys, detected changes and structures, each with its valve number."""
        valves = _numbers(results.valves)
        inverse = results.inverse
        codes, t = inverse_codes(inverse).tolist(), _times(inverse.t, now)
        for m, table in enumerate(inverse.map_U):
            if self._is_new(valves[m], INVERSE, table, codes[m]):
                yield valves[m], map_value(table, codes[m], t[m])
        yield from self._feed_forward(results, now)
        yield from self._waiting(results, now)
        yield from self._baselines(results, now)
        yield from self._recommended(results, now)
        yield from self._findings(results, now)
        yield from self._dynamics(results, now)
        for name, found in results.estimators.items():
            codes = estimator_own_words(found).tolist()
            t = _times(found.t, now)
            for m, valve in enumerate(valves):
                for new in self._of_estimator(valve, name, found, m, codes[m], t[m]):
                    yield valve, new

    def _of_estimator(
        self, valve: int, name: str, found: EstimatorResults, m: int, code: int, t: int
    ) -> Iterator[Shown]:
        survey, lags = found.survey[m], found.lags[m]
        discovery = found.change[m], found.structure[m]
        if lags is not None and self._is_new(valve, DIAGNOSTICS, None, *lags, code):
            yield from lag_values(lags, code, t)
        if self._is_new(valve, f"{name}.Coverage", survey, code):
            yield from survey_values(name, survey, code, t)
        if self._is_new(valve, name, None, *discovery, code):
            yield from discovery_values(name, *discovery, code, t)

    def _feed_forward(self, results: Results, now: int) -> Iterator[tuple[int, Shown]]:
        armed, statuses = results.inverse.armed.tolist(), results.inverse.feed_forward.tolist()
        for valve, is_armed, status in zip(_numbers(results.valves), armed, statuses, strict=True):
            if self._is_new(valve, FEED_FORWARD_STATUS, None, is_armed, status):
                for new in feed_forward_values(armed=is_armed, status=status, t=now):
                    yield valve, new

    def _waiting(self, results: Results, now: int) -> Iterator[tuple[int, Shown]]:
        for name, found in ((WAITING, results.waiting), (TIMING, results.timing)):
            for valve, sentences in zip(_numbers(results.valves), found, strict=False):
                if self._is_new(valve, name, None, sentences):
                    yield valve, Shown(name, list(sentences), int(ua.StatusCodes.Good), now)

    def _recommended(self, results: Results, now: int) -> Iterator[tuple[int, Shown]]:
        good = int(ua.StatusCodes.Good)
        for valve, found in zip(_numbers(results.valves), results.recommended, strict=False):
            if self._is_new(valve, RECOMMENDED, None, found):
                yield valve, Shown(RECOMMENDED, found.name, good, now)
                yield valve, Shown(RECOMMENDED_REASON, found.reason, good, now)

    def _findings(self, results: Results, now: int) -> Iterator[tuple[int, Shown]]:
        good = int(ua.StatusCodes.Good)
        for valve, found in zip(_numbers(results.valves), results.findings, strict=False):
            if self._is_new(valve, FINDINGS, None, found):
                yield valve, Shown(FINDINGS, [one.sentence for one in found], good, now)
                yield valve, Shown(FINDING_CODES, [int(one.code) for one in found], good, now)
                chances = [one.probability for one in found]
                yield valve, Shown(FINDING_PROBABILITIES, chances, good, now)

    def _dynamics(self, results: Results, now: int) -> Iterator[tuple[int, Shown]]:
        for valve, found in zip(_numbers(results.valves), results.dynamics, strict=False):
            if self._is_new(valve, DYNAMICS, found):
                for new in dynamics_values(found, now):
                    yield valve, new

    def _baselines(self, results: Results, now: int) -> Iterator[tuple[int, Shown]]:
        for valve, found in zip(_numbers(results.valves), results.baselines, strict=False):
            version = "" if found is None else found.version
            if self._is_new(valve, BASELINE, None, version):
                for new in baseline_values(found, now):
                    yield valve, new
                for name in results.estimators:
                    good = int(ua.StatusCodes.Good)
                    yield valve, Shown(f"{name}.{BUILDS_ON}", version, good, now)

    def _is_new(self, valve: int, name: str, thing: object, *facts: object) -> bool:
        """Whether the object or any of the facts differs from the last published ones.

        The object is compared by identity, the facts by equality.
        """
        key = valve, name
        before = self._said.get(key)
        if before is not None and before[0] is thing and before[1:] == facts:
            return False
        self._said[key] = thing, *facts
        return True


def _times(t: Times, now: int) -> list[int]:
    return _numbers(np.where(t, t, now))


def _numbers(array: Times) -> list[int]:
    numbers: list[int] = array.tolist()
    return numbers
