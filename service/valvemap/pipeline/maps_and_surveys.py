"""Inverse tables of all valves and surveys of all maps, computed in turns because they are slow."""

import math
from collections.abc import Mapping

import numpy as np

from valvemap.model.samples import Floats
from valvemap.model.survey import Survey
from valvemap.pipeline import required_signal, valve_state
from valvemap.pipeline.all_valves import AllValves
from valvemap.pipeline.lane_failures import Step
from valvemap.pipeline.sample_intake import SampleIntake

MAPS_AT_ONCE = 100  # tables per refresh, 2 ms each
SURVEYS_AT_ONCE = 40  # surveys per refresh, 0.5 ms each


class MapsAndSurveys:
    """The newest inverse table of each valve, and the newest survey of each estimator's map.

    Parameters
    ----------
    valves
        The valves.
    intake
        Judges a valve's signals whenever its table is recomputed.

    Attributes
    ----------
    tables : list
        For each valve, U in %, of shape (len(map_Q), len(map_dp)).
    surveys : list
        For each valve, its surveys by estimator; empty before the first `refresh`.
    """

    def __init__(self, valves: AllValves, intake: SampleIntake) -> None:
        self._valves = valves
        self._intake = intake
        self.tables = [np.full((len(p.map_Q), len(p.map_dp)), np.nan) for p in valves.plans]
        self._tabulate_first()
        self.surveys: list[Mapping[str, Survey]] = [{} for _ in valves.plans]
        self._next_survey = self._next_map = 0

    def refresh(self, share: float = 1.0) -> None:
        """Compute the next tables and surveys, or a ``share`` of them."""
        V = len(self._valves.plans)
        for _ in range(math.ceil(share * min(MAPS_AT_ONCE, V))):
            self.tabulate(self._next_map % V)
            self._next_map += 1
        self.refresh_surveys(share)

    def refresh_surveys(self, share: float = 1.0) -> None:
        """Compute the next surveys, or a ``share`` of them."""
        lanes = self._all_lanes()
        for _ in range(math.ceil(share * min(SURVEYS_AT_ONCE, len(lanes)))):
            self._refresh_survey(*lanes[self._next_survey % len(lanes)])
            self._next_survey += 1

    def refresh_all(self) -> None:
        """Compute every table and survey."""
        for valve in range(len(self._valves.plans)):
            self.tabulate(valve)
        for valve, name in self._all_lanes():
            self._refresh_survey(valve, name)

    def tabulate(self, valve: int) -> None:
        """Compute the table of one valve, unless its lane has failed."""
        inverse = self._valves.inverse(valve)
        if self._valves.runs(valve, inverse) and not self._valves.waits(valve, inverse):
            with self._valves.bulkhead(valve, Step.MAP, inverse):
                self.tables[valve] = required_signal.inverse_map(*self._valves.inverted(valve))
                self._intake.judge(valve)

    def _tabulate_first(self) -> None:
        """Compute the tables before the first sample: equal for valves with the same plan."""
        found: dict[tuple[object, ...], Floats] = {}
        for valve, plan in enumerate(self._valves.plans):
            key = (self._valves.kind(valve), plan.inverse, plan.map_Q, plan.map_dp)
            if key not in found:
                self.tabulate(valve)
            self.tables[valve] = found.setdefault(key, self.tables[valve])

    def _all_lanes(self) -> list[tuple[int, str]]:
        return [
            (valve, name) for valve, p in enumerate(self._valves.plans) for name in p.estimators
        ]

    def _refresh_survey(self, valve: int, name: str) -> None:
        if self._valves.runs(valve, name) and not self._valves.waits(valve, name):
            with self._valves.bulkhead(valve, Step.SURVEY, name):
                plan, state = self._valves.plans[valve], self._valves.state_of(valve, name)
                found = valve_state.survey_of(plan, state, name)
                self.surveys[valve] = {**self.surveys[valve], name: found}
