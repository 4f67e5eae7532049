"""Results of valves whose samples are old, come no more, or whose source is lost."""

import math

import structlog

from valvemap.model.samples import Floats
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.result_ports import ResultSink
from valvemap.runtime.result_publisher import ResultPublisher
from valvemap.runtime.sample_ages import SampleAges
from valvemap.runtime.stale_samples import StaleSamples

log = structlog.get_logger(__name__)


class DoubtedValves:
    """Publishes results as Uncertain or Bad where no newer sample supports them.

    Parameters
    ----------
    identification, sink, publisher
        Whose results are shown where, and how.
    stale, ages
        How old the newest samples are, and which of them are too old.
    """

    def __init__(
        self,
        identification: Identification,
        sink: ResultSink,
        publisher: ResultPublisher,
        stale: StaleSamples,
        ages: SampleAges,
    ) -> None:
        self._identification, self._sink, self._publisher = identification, sink, publisher
        self._stale, self._ages = stale, ages
        self._lost = publisher.lost

    async def doubt(self, now: float) -> None:
        """Mark valves as lost, overdue or old whose newest sample has aged past its limit."""
        ages = self._ages.of()
        stale, silent = self._stale.find_stale(now, ages, self._identification.stamping.holds)
        if len(silent):
            source_now = self._ages.source_now()[silent]
            self._publisher.note_new(self._identification.say_overdue(silent, source_now))
        if len(stale):
            await self.lose(stale[~self._lost[stale]].tolist())
        await self.doubt_old(ages)

    async def doubt_old(self, ages: Floats) -> None:
        """Set the shown results of newly old valves Uncertain, and queue their new results."""
        old = self._stale.find_old(ages, self._identification.stamping.holds)
        if len(old):
            await self._sink.doubt(old)
            self._publisher.note_new(old.tolist())

    async def lose(self, valves: list[int]) -> None:
        """Publish the results of these valves as Bad, at once."""
        for valve in valves:
            self._lost[valve] = True
            name = self._identification.plans[valve].name
            why = self._stale.why(valve, self._identification.results.waited_for(valve))
            log.warning("sensors lost", valve=name, why=why)
        if valves:
            self._publisher.note_new(valves)
            await self._publisher.publish_until(math.inf)
