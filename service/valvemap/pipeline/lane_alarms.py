"""What alarms of valves are judged by in their lanes: residuals, changes and lags. Pure."""

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.capabilities import FindsCauses, FindsLags, finds_changes
from valvemap.model.samples import Samples, Segments, Times, Trace
from valvemap.pipeline.alarms import Alarms
from valvemap.pipeline.compared_maps import ComparedMaps
from valvemap.pipeline.fleet_lanes import FleetLanes
from valvemap.pipeline.lane_failures import (
    CopyBuffer,
    Restore,
    Rows,
    Step,
    isolate,
    isolate_last,
    saved,
)
from valvemap.pipeline.valve_state import ValvePlan

MISFIT_EVERY_NS: Final = 10_000_000_000  # interval at which the adaptation status is polled


class LaneAlarms:
    """Judges the alarms of M valves.

    Parameters
    ----------
    plan
        Names the estimators.
    alarms, lanes, maps
        Those of the valves.
    t
        Time of each valve's newest sample, UTC ns (M,); the caller updates it in place.

    Attributes
    ----------
    finders : list of str
        Names of the estimators that find causes.
    changes : int
        How often an alarm, or its delay, began or ended in `judge`.
    """

    def __init__(
        self, plan: ValvePlan, alarms: Alarms, lanes: FleetLanes, maps: ComparedMaps, t: Times
    ) -> None:
        self._alarms, self._lanes, self._maps, self._t = alarms, lanes, maps, t
        names, estimators = [plan.inverse, *plan.estimators], plan.estimators
        self._finder = next((n for n in names if finds_changes(estimators[n])), None)
        self._laggard = next((n for n in names if isinstance(estimators[n], FindsLags)), None)
        self.finders = [n for n, one in estimators.items() if isinstance(one, FindsCauses)]
        self._misfit_due = np.zeros(len(t), np.int64)
        self._written = *alarms.written, self._misfit_due
        self.changes = 0

    def watch(
        self, judged: Samples, traces: Mapping[str, Trace], running: Segments, restore: Restore
    ) -> None:
        """Update the alarms with gated samples, and with what the estimators found in them.

        ``restore`` is a result of `saved`.
        """

        def watch(_: Rows) -> None:
            for name, own in self._maps.by_inverse(running.members):
                self._alarms.watch(judged, traces[name], running.of(own))
            self._note(running.members)

        isolate_last(running.members, watch, restore, self._lanes.stop_at(Step.ALARMS))

    def judge(self, chosen: Times, do: Callable[[Rows], None], buffer: CopyBuffer) -> None:
        """Judge alarms of the given valves (K,) by a quantity; ``do`` gets rows of the K."""
        running = (~self._lanes.stopped()[chosen]).nonzero()[0]

        def save(members: Times) -> Restore:
            buffer.clear()
            return saved(self._alarms.judged, members, buffer)

        before = self._alarms.begun(chosen)
        isolate(
            chosen[running], lambda rows: do(running[rows]), save, self._lanes.stop_at(Step.ALARMS)
        )
        self.changes += self._alarms.begun(chosen) != before

    def saved(self, members: Times, buffer: CopyBuffer) -> Restore:
        """Copy the alarms of the given valves; the result writes the copies back."""
        return saved(self._written, members, buffer)

    def columns(self) -> Mapping[str, NDArray[Any]]:
        """Return all arrays, each (M, …), not copied."""
        return {**self._alarms.columns(), "misfit_due": self._misfit_due}

    def _note(self, chosen: Times) -> None:
        """Update the alarms with the estimators' latest changes, lags and adaptation status."""
        lanes = self._lanes.by_name
        if self._finder is not None:
            found = lanes[self._finder].states.newest_changes(chosen)
            changes = found["count"], found["t"], found["size"]
            self._alarms.note_changes(chosen, *changes, weighed=self._finder in self.finders)
        if self._laggard is not None:
            self._alarms.note_lags(chosen, lanes[self._laggard].states.largest_lags(chosen))
        due = chosen[self._t[chosen] >= self._misfit_due[chosen]]
        if len(due):
            self._misfit_due[due] = self._t[due] + MISFIT_EVERY_NS
            for name, own in self._maps.by_inverse(due):
                some = due[own]
                rmse = self._maps.recent_rmse(some, name)
                self._alarms.note_misfit(some, self._maps.adaptations(some)[name], rmse)
