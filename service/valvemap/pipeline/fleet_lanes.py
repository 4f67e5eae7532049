"""The lanes of all estimators on the valves of a fleet, and which of them have stopped. Pure."""

from collections.abc import Collection, Mapping, Sequence
from functools import partial

from valvemap.model.samples import Flags, Times
from valvemap.pipeline.alarms import Alarms
from valvemap.pipeline.lane_failures import LaneFailure, LaneFailures, Step, Stop
from valvemap.pipeline.lanes import Lanes


class FleetLanes:
    """The lanes of M valves.

    Parameters
    ----------
    lanes
        By estimator.
    waits
        Names of the estimators that do not run: their lanes keep their initial states.
    valves
        Names of the valves.
    t
        Time of each valve's newest sample, UTC ns (M,); the caller updates it in place.
    failures, alarms
        Where a failure is noted.

    Attributes
    ----------
    changes : int
        How often a lane was stopped.
    """

    def __init__(
        self,
        lanes: Mapping[str, Lanes],
        waits: Collection[str],
        valves: Sequence[str],
        t: Times,
        failures: LaneFailures,
        alarms: Alarms,
    ) -> None:
        self.by_name = lanes
        self.numbers = {name: number for number, name in enumerate(lanes)}
        self.waits = frozenset(waits) & lanes.keys()
        self._valves, self._t = valves, t
        self._failures, self._alarms = failures, alarms
        self.changes = 0

    def stopped(self) -> Flags:
        """Mask (M,) of the valves whose lanes have all failed: their samples are not processed."""
        first, *others = [lanes.failed for lanes in self.by_name.values()]
        for failed in others:
            first &= failed
        return first

    def has_failed(self, m: int, name: str) -> bool:
        """Whether a lane of one valve stopped at an error."""
        return bool(self.by_name[name].failed[m])

    def stop(self, name: str | None, step: Step, m: int, error: Exception) -> None:
        """Stop one lane of a valve, or (None) all of them, because of an error in a step.

        Lanes that stopped before are unchanged: an error is noted once.
        """
        lanes = self.by_name.values() if name is None else [self.by_name[name]]
        if all(one.failed[m] for one in lanes):
            return
        self.changes += 1
        for one in lanes:
            one.fail(m)
        failure = LaneFailure(self._valves[m], name, step, error)
        self._failures.note(failure)
        self._alarms.note_failure(m, failure.reason, whole=name is None)
        self.show_stopped(m)

    def stop_at(self, step: Step, name: str | None = None) -> Stop:
        """Return `stop` for one lane, or for all, at a step."""
        return partial(self.stop, name, step)

    def start_again(self, m: int) -> None:
        """Resume all lanes, if an error in a step of the whole valve has stopped them."""
        if self._alarms.stopped_whole(m):
            for lanes in self.by_name.values():
                lanes.start_again(m)
        self.show_stopped(m)

    def show_stopped(self, m: int) -> None:
        """Update the alarm with the number of stopped lanes."""
        count = sum(bool(lanes.failed[m]) for lanes in self.by_name.values())
        self._alarms.note_stopped(m, count, int(self._t[m]))

    def beyond(self, m: int) -> Mapping[str, int]:
        """Return, by estimator, the number of one valve's samples beyond its range."""
        return {name: int(lanes.beyond[m]) for name, lanes in self.by_name.items()}

    def count_beyond(self, m: int, name: str, count: int) -> None:
        """Restore that number for one estimator."""
        self.by_name[name].beyond[m] = count
