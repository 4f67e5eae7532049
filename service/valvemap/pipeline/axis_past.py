"""The sums of an axis as they were before a sudden change was found. Pure.

Between a change and its discovery, rows are summed as those of the map before. Where the map knew
little, it follows them; with the gain that is found later, the change is then in it twice.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from valvemap.model.axis import AxisState
from valvemap.model.kernels.flow_drift import OF_VALVE
from valvemap.model.kernels.flow_rules import UNNOTICED
from valvemap.pipeline.axis_watch import SUMS

STEP_S: Final = 10.0  # s of movement between two kept states
KEPT: Final = 1 + round(UNNOTICED / STEP_S)  # the oldest is as old as a change unnoticed, or older
_SURE: Final = 4.0  # standard deviations by which gain or shift is another one


@dataclass(frozen=True)
class Past:
    """A value: the states of the last 20 to 30 s of movement, the oldest first.

    ``since_s`` is the movement since the newest of them.
    """

    states: tuple[AxisState, ...] = ()
    since_s: float = 0.0

    def after(self, state: AxisState, passed_s: float) -> "Past":
        """Return the past after ``passed_s`` s of movement, which led to a state."""
        since_s = self.since_s + passed_s
        if self.states and since_s < STEP_S:
            return replace(self, since_s=since_s)
        return Past((*self.states, state)[-KEPT:])

    def without_change(self, state: AxisState) -> tuple["Past", AxisState]:
        """Return both with the sums from before a change of an edge, if one was just found."""
        if not self.states or not _has_moved(self.states[0], state):
            return self, state
        oldest = self.states[0]
        sums = {name: getattr(oldest, name) for name in (*SUMS, "score")}
        before = replace(state, **sums)
        return Past((before,)), before


def _has_moved(then: AxisState, now: AxisState) -> bool:
    """Whether an edge's gain or shift is another one, for certain."""
    before, after = then.drift_now[:, 0, :OF_VALVE], now.drift_now[:, 0, :OF_VALVE]
    own = np.arange(OF_VALVE)
    variance = then.drift_now[:, 1 + own, own] + now.drift_now[:, 1 + own, own]
    return bool(((after - before) ** 2 > _SURE**2 * variance).any())
