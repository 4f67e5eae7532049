"""Answers to standing demands and tables of the inverse maps, as arrays over valves."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from valvemap.model.samples import Flags, Times
from valvemap.pipeline.all_valves import AllValves
from valvemap.pipeline.armed_valves import ArmedValves
from valvemap.pipeline.estimator_commands import EstimatorCommands
from valvemap.pipeline.fleet import Fleet
from valvemap.pipeline.lane_failures import Step
from valvemap.pipeline.line_inverse import NO_ANSWER, LineAnswer, LineInverse
from valvemap.pipeline.maps_and_surveys import MapsAndSurveys
from valvemap.pipeline.results import EstimatorResults, InverseResults, LineResults, Results
from valvemap.vocabulary.statuses import InverseStatus, Quality

_GUESSED = np.zeros(max(InverseStatus) + 1, np.bool_)
_GUESSED[[InverseStatus.EXTRAPOLATING, InverseStatus.OUTSIDE]] = True


class InverseTables:
    """Collects the inverse results of valves and lines.

    Parameters
    ----------
    valves
        The valves.
    maps
        Inverse tables, as computed last.
    armed
        State of their feed-forward.
    commands, lines
        Compute the answers to their standing demands.
    """

    def __init__(
        self,
        valves: AllValves,
        maps: MapsAndSurveys,
        armed: ArmedValves,
        commands: EstimatorCommands,
        lines: LineInverse,
    ) -> None:
        self._valves = valves
        self._maps = maps
        self._armed = armed
        self._commands = commands
        self._lines = lines

    def of(
        self, fleet: Fleet, valves: Times, estimators: Mapping[str, EstimatorResults]
    ) -> InverseResults:
        """Return the inverse results of valves of one fleet, beside their estimators' results."""
        M, places = len(valves), self._valves.places[valves]
        inverses = fleet.maps.inverses(places)
        t, quality = np.zeros(M, np.int64), np.zeros(M, np.uint8)
        for name, found in estimators.items():
            own = np.array([inverse == name for inverse in inverses])
            t[own], quality[own] = found.t[own], found.quality[own]
        U, lower, upper = np.full((3, M), np.nan)
        status = np.full(M, np.uint8(InverseStatus.NOT_FINITE))
        demanded: Flags = np.asarray(np.isfinite(fleet.inputs.demand[places]).all(axis=1))
        for k in demanded.nonzero()[0]:
            (U[k], lower[k], upper[k], status[k]), _ = self._commands.required(int(valves[k]))
            if not self._valves.runs(int(valves[k]), inverses[k]):
                quality[k] = Quality.BAD
        guessed = (_GUESSED[status] & demanded).astype(np.float64)
        if guessed.any() or fleet.alarms.have_guessed(places):
            fleet.watch(places, lambda rows: fleet.alarms.note_answers(places[rows], guessed[rows]))
        return InverseResults(
            t=t,
            quality=quality,
            required_U=U,
            status=status,
            map_U=[self._maps.tables[valve] for valve in valves],
            armed=self._armed.armed[valves],
            feed_forward=self._armed.status[valves],
            lower=lower,
            upper=upper,
        )

    def of_lines(self, found: Results, valves: Times) -> Results:
        """Return the results of lines, whose edges answer the demands; of valves as they are."""
        if not self._lines.is_line(int(valves[0])):
            return found
        answers = [self._line_answer(valve) for valve in valves.tolist()]
        U, lower, upper, status, edge = (
            np.array(x, np.float64) for x in zip(*answers, strict=True)
        )
        leakage, std = self._lines.leakages(valves.tolist())
        codes = status.astype(np.uint8)
        inverse = replace(found.inverse, required_U=U, status=codes, lower=lower, upper=upper)
        lines = LineResults(np.array(leakage), np.array(std), edge.astype(np.uint8))
        return replace(found, inverse=inverse, lines=lines)

    def _line_answer(self, line: int) -> LineAnswer:
        with self._valves.bulkhead(line, Step.INVERSE):
            return self._lines.required(line)
        return NO_ANSWER

    def unknown(self, valve: int, t: Times) -> InverseResults:
        """Return Bad inverse results of one valve at the time ``t`` (1,) of its newest sample."""
        one, plan = np.array([valve]), self._valves.plans[valve]
        nothing = np.full(1, np.nan)
        return InverseResults(
            t=t,
            quality=np.full(1, Quality.BAD, np.uint8),
            required_U=nothing,
            status=np.full(1, InverseStatus.NOT_FINITE, np.uint8),
            map_U=[np.full((len(plan.map_Q), len(plan.map_dp)), np.nan)],
            armed=self._armed.armed[one],
            feed_forward=self._armed.status[one],
            lower=nothing,
            upper=nothing,
        )
