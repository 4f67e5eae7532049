"""The service's own health: its load, its states and its alarms, published at an interval."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from valvemap.clock import Clock
from valvemap.pipeline.alarm_results import AlarmReport
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.result_ports import COMPLETE, Health, PastCounters, ResultSink
from valvemap.pipeline.source_ports import AllSources
from valvemap.pipeline.store_ports import CheckpointStore, KeptElsewhere
from valvemap.runtime.past import PastKeeper
from valvemap.runtime.sample_ages import SampleAges
from valvemap.runtime.state_keeper import StateKeeper

EVERY_S: Final = 0.5  # s; interval at which the service's health is published
DAY_NS: Final = 86_400_000_000_000


class ServiceHealth:
    """Watches a live service and publishes its health.

    Attributes
    ----------
    worked_s
        Time spent on samples since the last publication, s.
    kept_elsewhere
        The states of another keeper; None: there are none.
    certificate_until_ns
        Expiry of the service's certificate, UTC ns; 0: no persistent certificate.
    """

    def __init__(
        self,
        identification: Identification,
        source: AllSources,
        sink: ResultSink,
        store: CheckpointStore,
        keeper: StateKeeper,
        past: PastKeeper | None,
        clock: Clock,
        ages: SampleAges,
    ) -> None:
        self._identification, self._source, self._sink = identification, source, sink
        self._store, self._keeper, self._past = store, keeper, past
        self._clock, self._ages = clock, ages
        self.worked_s = 0.0
        self.start_state = COMPLETE
        self.kept_elsewhere: KeptElsewhere | None = None
        self.certificate_until_ns = 0
        self._since = self._due = clock.monotonic()

    async def show_if_due(self, now: float, *, late: bool) -> None:
        """Publish the health, at most every EVERY_S; ``late``: results are published late."""
        if now < self._due:
            return
        self._due = now + EVERY_S
        elsewhere = self.kept_elsewhere
        other_s = math.nan if elsewhere is None else elsewhere.age_s(now)
        alarms = self._watch(now, other_s, late=late)
        known_s = other_s if math.isfinite(other_s) else math.nan
        age_s = float(np.fmax(now - self._keeper.kept_at, known_s))
        keepers = [one for one in (self._keeper, elsewhere) if one is not None]
        await self._sink.show_health(
            Health(
                age_s=self._ages.of(),
                waiting=self._identification.arrivals.pending(),
                source=self._source.counters,
                source_states=self._source.states,
                checkpoint_age_s=age_s,
                checkpoint_failures=sum(one.failures for one in keepers),
                checkpoints_refused=sum(one.refused for one in keepers),
                checkpoint_bytes=self._store.size,
                history=PastCounters() if self._past is None else self._past.counters,
                alarms=alarms,
                start=self.start_state,
            )
        )

    def _watch(self, now: float, other_s: float, *, late: bool) -> Sequence[AlarmReport]:
        """Judge the alarms; ``other_s`` is the age of states kept elsewhere, NaN: there are none.

        The keeper's own age is 0 without valves.
        """
        passed, worked = now - self._since, self.worked_s
        self.worked_s, self._since = 0.0, now
        until, utc = self.certificate_until_ns, self._clock.now()
        share = min(worked / passed, 1.0) if passed > 0.0 else math.nan
        return self._identification.watch_service(
            utc,
            checkpoint_age_s=float(np.fmax(self._keeper.age_s(now), other_s)),
            days_left=(until - utc) / DAY_NS if until else math.nan,
            load=1.0 if late else share,
            history_waits_s=math.nan if self._past is None else self._past.waits_s(now),
        )
