"""Publishes the results of many valves in a few array writes."""

from dataclasses import replace

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from guarded_opcua import Clock
from valvemap.model.samples import Times
from valvemap.opcua_results.changed_results import ChangedResults
from valvemap.opcua_results.information_model import PENDING, SAMPLE_AGE
from valvemap.opcua_results.result_alarms import ResultAlarms
from valvemap.opcua_results.result_blocks import Generations
from valvemap.opcua_results.result_frames import frames
from valvemap.opcua_results.result_health import ResultHealth
from valvemap.opcua_results.result_slots import ValveSlots
from valvemap.opcua_results.result_values import Column, columns_of
from valvemap.opcua_results.result_variables import ResultVariables
from valvemap.pipeline.operator_ports import Operator
from valvemap.pipeline.result_ports import Health
from valvemap.pipeline.results import Results
from valvemap.vocabulary.statuses import Quality


class ResultPublishing:
    """Publishes results and tracks per valve when its scalars are due.

    Parameters
    ----------
    slots
        The valves that are shown.
    blocks, variables
        Hold the values that change with each result, and those that are rare or large.
    alarms, health
        Publish the alarms and the DeviceHealth of valves.
    operator
        Holds the state of alarms.
    clock
        Source time of values without a sample.
    scalars_interval_s
        Minimum time between two updates of a valve's scalar variables. Bad values are always
        published immediately.
    """

    def __init__(
        self,
        slots: ValveSlots,
        blocks: Generations,
        variables: ResultVariables,
        alarms: ResultAlarms,
        health: ResultHealth,
        operator: Operator,
        clock: Clock,
        scalars_interval_s: float,
    ) -> None:
        self._slots = slots
        self._blocks = blocks
        self._variables = variables
        self._alarms = alarms
        self._health = health
        self._operator = operator
        self._clock = clock
        self._scalars_interval_s = scalars_interval_s
        self._sequences = np.zeros(len(slots), np.int64)
        self._scalars_due = np.full(len(slots), -np.inf)
        self._changed = ChangedResults(len(slots), slots.most_counters)

    def follow(self, scalars_interval_s: float) -> None:
        """Switch to the valves that the slots hold now; republish all rare or large values."""
        came = len(self._slots) - len(self._sequences)
        self._scalars_interval_s = scalars_interval_s
        self._sequences = np.append(self._sequences, np.zeros(came, np.int64))
        self._scalars_due = np.append(self._scalars_due, np.full(came, -np.inf))
        self._changed = ChangedResults(len(self._slots), self._slots.most_counters)

    def is_heard_of(self, valve: str) -> bool:
        """Whether a result of a valve was published."""
        slot = self._slots.by_name.get(valve)
        return slot is not None and bool(self._sequences[slot])

    def publish(self, results: Results) -> None:
        """Publish results of valves with the same layout, numbered as the operator numbers them."""
        results = replace(results, valves=self._slots.of(results.valves))
        now, valves = self._clock.now(), results.valves
        self._sequences[valves] += 1
        described = self._slots[int(valves[0])]
        whole = frames(described, results, self._sequences[valves], now)
        self._blocks.write(valves, [whole])
        due = self._due(results)
        by_name = [e.name for e in described.estimators if e.has_named_parameters]
        columns = columns_of(results, now, by_name)
        if not due.all():
            columns = (column[due] for column in columns)
        self._blocks.write(valves[due], (*columns, *self._changed.counts(results, due, now)))
        for valve, new in self._changed.values(results, now):
            self._variables.show(self._slots[valve].name, new)
        self._alarms.publish(results, now)
        for number in valves[self._sequences[valves] == 1].tolist():
            name = self._slots[number].name
            if name in self._health:
                self._health.stands(name, self._operator.alarms(name))

    def doubt(self, valves: Times) -> None:
        """Mark Good values of the operator's valves, given by number, as Uncertain."""
        self._blocks.doubt(self._slots.of(valves))

    def publish_waits(self, health: Health, now: int) -> None:
        """Publish each valve's sample age and pending samples; ``now`` in UTC ns."""
        every = self._slots.every
        t = np.full(len(every), now)
        good = np.full(len(every), ua.StatusCodes.Good, np.uint32)
        waits = np.uint32(ua.StatusCodes.BadWaitingForInitialData)
        known = np.where(np.isnan(health.age_s), waits, good)
        self._blocks.write(
            every,
            [Column(SAMPLE_AGE, health.age_s, known, t), Column(PENDING, health.waiting, good, t)],
        )

    def _due(self, results: Results) -> NDArray[np.bool_]:
        """Return which valves' scalar variables are due now, (M,)."""
        now, valves = self._clock.monotonic(), results.valves
        due = now >= self._scalars_due[valves]
        for estimator in results.estimators.values():
            due |= estimator.quality == Quality.BAD
        self._scalars_due[valves[due]] = now + self._scalars_interval_s
        return due
