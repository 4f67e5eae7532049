"""The metrics of a worker: written by its thread, read by the exporter's.

Only groups and valves of the catalogue have series, so that no message can add one. A group has
series while its partition is assigned to this worker.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from valvemap.clock import Clock, SystemClock
from valvemap.kafka.client_statistics import ClientStatistics, read_statistics
from valvemap.kafka.result_blocks import ResultsBlock
from valvemap.kafka.topics import COMMANDS, SAMPLES
from valvemap.opcua_results.valve_variables import counter_name
from valvemap.pipeline.alarm_results import AlarmReport
from valvemap.vocabulary import fleet_series, series
from valvemap.vocabulary.quantities import FRAME_QUANTITIES
from valvemap.vocabulary.series import Point


@dataclass
class _OfValve:
    """The newest figures of a valve."""

    alarms_version: int = -1
    alarms: tuple[AlarmReport, ...] = ()
    estimators: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    counters: Mapping[str, int] = field(default_factory=dict)


@dataclass
class _OfGroup:
    """The newest figures of a group."""

    partition: str = ""
    number: int = 0
    newest: int = 0
    counts: Mapping[str, int] = field(default_factory=dict)
    valves: dict[str, _OfValve] = field(default_factory=dict)


class WorkerMetrics:
    """Figures of one worker process, over all losses of the broker.

    Parameters
    ----------
    topics
        Names of the topics that a worker reads. The partitions of the first are the groups'.
    clock
        The system clock if None.
    """

    def __init__(self, topics: Sequence[str], clock: Clock | None = None) -> None:
        self._topics = tuple(topics)
        self._clock = clock or SystemClock()
        self._groups: dict[str, _OfGroup] = {}
        self._messages: Counter[str] = Counter()
        self._consumer: ClientStatistics | None = None
        self._producer = ClientStatistics()
        self._committed = self._clock.monotonic()
        self._commits = self._rejected = self._unshown = self._restarts = 0

    def note_message(self, kind: str, key: bytes | None, partition: int) -> None:
        """Count a message, and note the partition of its group after `note_group`."""
        self._messages[kind] += 1
        group = self._groups.get((key or b"").decode("utf-8", "replace"))
        if group is not None:
            group.partition = str(partition)

    def note_rejected(self, number: int) -> None:
        """Count dead letters."""
        self._rejected += number

    def note_group(self, group: str, number: int, counts: Mapping[str, int]) -> None:
        """Note a group's newest block and its counters."""
        of = self._groups.setdefault(group, _OfGroup())
        of.number, of.counts = number, counts

    def note_results(self, block: ResultsBlock) -> None:
        """Note the results of a group, before its next update."""
        try:
            self._note_results(block)
        except Exception:  # noqa: BLE001 - bulkhead: metrics must not reject a message
            self._unshown += 1

    def note_commit(self) -> None:
        """Note a commit that begins."""
        self._commits += 1
        self._committed = self._clock.monotonic()

    def note_restart(self) -> None:
        """Note a loss of the broker: nothing is assigned to this worker."""
        self._restarts += 1
        self._consumer, self._producer = ClientStatistics(), ClientStatistics()

    def note_consumer(self, packed: str) -> None:
        """Note the statistics of the worker's consumer."""
        self._consumer = read_statistics(packed)

    def note_producer(self, packed: str) -> None:
        """Note the statistics of the worker's producer."""
        self._producer = read_statistics(packed)

    def points(self) -> Iterator[Point]:
        """Yield all metrics."""
        consumer = self._consumer or ClientStatistics()
        for kind in (SAMPLES, COMMANDS):
            yield Point(fleet_series.WORKER_MESSAGES, self._messages[kind], (kind,))
        yield Point(fleet_series.WORKER_REJECTED, self._rejected)
        yield Point(fleet_series.WORKER_COMMITS, self._commits)
        yield Point(fleet_series.WORKER_COMMIT_AGE, self._clock.monotonic() - self._committed)
        yield Point(fleet_series.WORKER_RESTARTS, self._restarts)
        yield Point(fleet_series.WORKER_UNSHOWN, self._unshown)
        yield Point(fleet_series.WORKER_UNSENT, self._producer.unsent)
        for place, lag in consumer.lag.items():
            if place[0] in self._topics:  # the client reads the states, too
                yield Point(fleet_series.WORKER_LAG, lag, place)
                yield Point(fleet_series.WORKER_FETCHED, consumer.fetched[place], place)
        for name, group in list(self._groups.items()):
            if self._consumer is None or (self._topics[0], group.partition) in consumer.lag:
                yield from self._of_group(name, group)

    def _of_group(self, name: str, group: _OfGroup) -> Iterator[Point]:
        yield Point(fleet_series.GROUP_BLOCK, group.number, (name,))
        for what, count in list(group.counts.items()):
            yield Point(fleet_series.GROUP_TROUBLE, count, (name, what))
        if group.newest:
            age_s = (self._clock.now() - group.newest) * 1e-9
            yield Point(fleet_series.GROUP_AGE, age_s, (name,))
        for valve, newest in list(group.valves.items()):
            yield from _of_valve(valve, newest)

    def _note_results(self, block: ResultsBlock) -> None:
        """Keep plain numbers; points are made of them on request."""
        of, results = self._groups.setdefault(block.group, _OfGroup()), block.results
        rows = {
            name: list(zip(*(getattr(found, q.field).tolist() for q in _SHOWN), strict=True))
            for name, found in results.estimators.items()
        }
        counters = results.counters.tolist()
        for m, number in enumerate(results.valves.tolist()):
            valve = of.valves.setdefault(block.valves[number], _OfValve())
            valve.estimators = {name: of_estimator[m] for name, of_estimator in rows.items()}
            valve.counters = dict(zip(results.counter_names, counters[m], strict=True))
            if results.alarms is None:
                continue
            version = int(results.alarms.version[m])
            if version != valve.alarms_version:
                valve.alarms = tuple(results.alarms.reports(m))
                valve.alarms_version = version
        newest = (int(found.t.max(initial=0)) for found in results.estimators.values())
        of.newest = max(of.newest, *newest, 0)


def _of_valve(name: str, valve: _OfValve) -> Iterator[Point]:
    for report in valve.alarms:
        yield from _alarm(name, report)
    for estimator, values in valve.estimators.items():
        for quantity, value in zip(_SHOWN, values, strict=True):
            yield Point(series.QUANTITIES[quantity.name], value, (name, estimator))
    for counter, count in valve.counters.items():
        yield Point(series.DIAGNOSTICS, count, (name, _counter(counter)))


def _counter(name: str) -> str:
    """The browse name of a counter, which the page's series have, too."""
    return counter_name(name).rpartition(".")[2]


def _alarm(valve: str, report: AlarmReport) -> Iterator[Point]:
    """Yield the series of an alarm that is active or waits for an operator."""
    waits = not (report.acked and report.confirmed)
    if report.active or waits:
        labels = (valve, report.name)
        severity = float(report.severity if report.active else 0)
        yield Point(series.ALARM_SEVERITY, severity, labels)
        yield Point(series.ALARM_WAITING, float(waits), labels)


_SHOWN: Final = tuple(q for q in FRAME_QUANTITIES if q.series is not None)
