"""What clients read of the history, against what was published: for seeds with the real file."""

import asyncio
from collections import Counter

import numpy as np
from asyncua import ua

from guarded_opcua.history.historian import EVER, Span
from guarded_opcua.history.reading import Rest, _page
from simulation.stores import column_of
from valvemap.opcua_results.past import ResultsPast
from valvemap.runtime.past_pieces import results_of, signals_of
from valvemap.vocabulary.statuses import Quality

_NEXT_S = 1.0  # the longest time between the pages of one reader


class Rows:
    """The times of all published rows, by series: of this life, and those stored before it."""

    def __init__(self, world):
        self._world = world
        self._stored, self._published = {}, {}
        self._lost = 0

    def begin(self):
        """A process starts: what the one before had not saved is lost with it."""
        names = self._stored.keys() | self._published.keys()
        self._stored = {series: self._world.past.times(series) for series in names}
        self._published, self._lost = {}, self._world.past.lost

    def add(self, series, t):
        """Rows of these times were published."""
        self._published.setdefault(series, set()).update(t.tolist())

    def publish(self, name, results, m):
        """The results of valve m of a batch were published; Bad ones lie 1 ns behind a sample."""
        inverse, signals = results.inverse, results.signals
        rows = [(results_of(name, part), of) for part, of in results.estimators.items()]
        rows.append((results_of(name, "Inverse"), inverse))
        if signals.quality[m] == Quality.BAD:
            rows.append((signals_of(name), signals))
        for series, of in rows:
            t = of.t[m] + (of.quality[m] == Quality.BAD)
            if t > 1:
                self.add(series, np.array([t]))

    def judge(self, keeper):
        """History = published values minus counted losses."""
        missing, invented = Counter(), Counter()
        for series in self._stored.keys() | self._published.keys():
            known = self._known(series)
            found = self._world.past.times(series)
            missing[series], invented[series] = len(known - found), len(found - known)
        if sum(missing.values()) > keeper.counters.lost - self._lost:
            self._world.violated(f"history lacks {dict(+missing)}, counted {keeper.counters.lost}")
        if +invented:
            self._world.violated(f"history holds rows never published: {dict(+invented)}")

    def _known(self, series):
        return self._stored.get(series, set()) | self._published.get(series, set())

    async def read(self, part, valve, most, backwards):
        """A client reads a whole series in pages, while the service writes it."""
        world, one = self._world, self._world.plant[valve]
        series = f"{one.name}.{one.estimator if part == 'estimator' else part}"
        variable = ua.NodeId(f"{series}.{column_of(series)}", 2)
        past, before, got = ResultsPast(world.past), world.past.times(series), []

        async def raw(span, skip, count):
            return await past.raw(variable, span, skip, count)

        rest = Rest(variable, Span(*EVER, backwards), page=most)
        while rest is not None:
            found, rest = await _page(rest, most, raw, ua.VariantType.Double)
            got += found.source.tolist()
            await asyncio.sleep(world.rng.uniform(0.0, _NEXT_S))
        world.counts["rows read"] += len(got)
        if got != sorted(set(got), reverse=backwards):
            world.violated(f"{series} is read twice or out of order")
        if left := before - set(got):
            world.violated(f"a client misses {len(left)} of {len(before)} rows of {series}")
        if invented := set(got) - self._known(series):
            world.violated(f"a client reads {len(invented)} rows of {series} never published")
