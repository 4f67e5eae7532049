"""The page's metrics, read from the service's nodes on request."""

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from valvemap.page.exposition import build_point, exposition, refusals
from valvemap.page.observer import Link, Observer
from valvemap.vocabulary import series
from valvemap.vocabulary.series import Point, Series

if TYPE_CHECKING:
    from valvemap.page.door import Door
    from valvemap.page.guard import Guard
    from valvemap.page.log_ins import LogIns
    from valvemap.page.viewers import Viewers


class Metrics:
    """All metrics of one page process."""

    def __init__(
        self,
        observer: Observer,
        viewers: "Viewers",
        guard: "Guard",
        log_ins: "LogIns",
        door: "Door",
    ) -> None:
        self._observer = observer
        self._viewers = viewers
        self._guard = guard
        self._log_ins = log_ins
        self._door = door

    def exposition(self) -> bytes:
        """Return the metrics in Prometheus text format."""
        return exposition(self.points())

    def points(self) -> Iterator[Point]:
        """Yield all metrics."""
        up = self._observer.link is Link.UP
        yield Point(series.SERVICE_UP, float(up))
        yield build_point()
        if up:
            yield from self._of_valves()
            yield from self._of_axes()
            yield from self._of_alarms()
            yield from self._of_service()
        yield Point(series.PAGE_VIEWERS, float(len(self._viewers)))
        yield Point(series.PAGE_LOG_INS, float(len(self._log_ins)))
        yield Point(series.PAGE_CONNECTIONS, float(len(self._door)))
        yield from self._refusals()

    def _refusals(self) -> Iterator[Point]:
        counts = {
            **refusals(self._guard, self._door),
            "viewers": self._viewers.refused,
            "senseless": self._viewers.senseless,
            "log_in": self._log_ins.failed,
            "tries": self._log_ins.refused,
        }
        for why, count in counts.items():
            yield Point(series.PAGE_REFUSED, count, (why,))

    def _of_valves(self) -> Iterator[Point]:
        for number, row in self._observer.standings.rows.items():
            name = (self._observer.valves[number].name,)
            yield Point(series.VALVE_SEVERITY, float(row.reason.severity), name)
            yield Point(series.FIRST_RMSE, row.rmse, name)
            yield Point(series.SAMPLES, row.samples, name)
            yield Point(series.SILENT, self._observer.standings.silent_s(number), name)
        for number, columns in self._observer.standings.frames.items():
            valve = self._observer.valves[number]
            for estimator in valve.estimators:
                for quantity, one in series.QUANTITIES.items():
                    value = columns.get(f"{estimator}.{quantity}", math.nan)
                    yield Point(one, value, (valve.name, estimator))
        for (name_, what), value in self._observer.figures.valves.items():
            if what in _OF_VALVE:
                yield Point(_OF_VALVE[what], value, (name_,))
            elif what.startswith("Lag"):
                yield Point(series.LAG, value, (name_, what.removeprefix("Lag")))
            else:
                yield Point(series.DIAGNOSTICS, value, (name_, what))

    def _of_axes(self) -> Iterator[Point]:
        for (axis, name), value in self._observer.figures.axes.items():
            yield Point(series.AXES[name], value, (axis,))

    def _of_alarms(self) -> Iterator[Point]:
        """Yield the alarms that are active or wait for an operator; the others have no series."""
        for labels, change in self._observer.alarms.present.items():
            severity = float(change.severity if change.active else 0)
            yield Point(series.ALARM_SEVERITY, severity, labels)
            waits = not (change.acked and change.confirmed)
            yield Point(series.ALARM_WAITING, float(waits), labels)

    def _of_service(self) -> Iterator[Point]:
        """Yield checkpoint state, lost data, sessions and refusals of the service."""
        of_service, of_server = self._observer.figures.service, self._observer.figures.server
        for name, value in of_service.items():
            part, _, what = name.partition(".")
            if part == "Source":
                yield Point(series.SOURCE, value, (what,))
            elif name in _OF_SERVICE:
                yield Point(_OF_SERVICE[name], value)
        for name, value in of_server.items():
            if name in _OPEN:
                yield Point(_OPEN[name], value)
            elif name in _REFUSED:
                yield Point(series.REFUSED, value, (_REFUSED[name],))


_OF_VALVE: dict[str, Series] = {"SampleAge": series.SAMPLE_AGE, "Pending": series.PENDING}
_OF_SERVICE: dict[str, Series] = {
    "Start.Compiled": series.COMPILED,
    "Checkpoint.Age": series.CHECKPOINT_AGE,
    "Checkpoint.Failures": series.CHECKPOINT_FAILURES,
    "Checkpoint.Refused": series.CHECKPOINT_REFUSED,
    "Checkpoint.Size": series.CHECKPOINT_BYTES,
}
_OPEN: dict[str, Series] = {
    "CurrentSessionCount": series.SESSIONS,
    "CurrentSubscriptionCount": series.SUBSCRIPTIONS,
}
_REFUSED = {
    "RejectedSessionCount": "sessions",
    "SecurityRejectedSessionCount": "sessions for security",
    "RejectedRequestsCount": "requests",
    "SecurityRejectedRequestsCount": "requests for security",
}
