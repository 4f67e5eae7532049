"""What a simulated service shows: its newest results, and what each publication stores."""

import asyncio
from dataclasses import dataclass, field

from valvemap.runtime.past_pieces import INVERSE, results_of, signals_of
from valvemap.vocabulary.statuses import Quality


@dataclass
class Shown:
    """Implements `ResultSink`: the newest results of each valve."""

    world: object
    quality: dict = field(default_factory=dict)
    t: dict = field(default_factory=dict)

    async def publish(self, results):
        world = self.world
        for m, valve in enumerate(results.valves.tolist()):
            name, own = world.plant[valve].name, world.plant[valve].estimator
            found = results.estimators[own]
            self.quality[valve], self.t[valve] = int(found.quality[m]), int(found.t[m])
            world.note((valve, self.quality[valve], self.t[valve], int(found.sample_count[m])))
            for estimator, of in results.estimators.items():
                world.published[results_of(name, estimator)] += int(of.t[m] > 0)
            world.published[results_of(name, INVERSE)] += int(results.inverse.t[m] > 0)
            lost = results.signals.quality[m] == Quality.BAD and results.signals.t[m] > 0
            world.published[signals_of(name)] += int(lost)
            if world.rows is not None:
                world.rows.publish(name, results, m)
        if world.case.sink_s:
            await asyncio.sleep(world.case.sink_s)

    async def doubt(self, valves):
        for valve in valves.tolist():
            if self.quality.get(valve) == Quality.GOOD:
                self.quality[valve] = int(Quality.UNCERTAIN)

    async def show_health(self, health):
        self.world.note(health.source_states)
