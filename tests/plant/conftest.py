"""Plants in memory: what browsing returned, and ten seconds of values."""

import numpy as np
import pytest

from valvemap.app.connect import judged
from valvemap.app.connect_answers import Wanted
from valvemap.pipeline.units import unit_of
from valvemap.plant.candidates import Candidate
from valvemap.plant.evidence import Rating
from valvemap.plant.grouping import group
from valvemap.plant.possible import possible_valves
from valvemap.plant.reading import Record
from valvemap.plant.unused import unused

STEP = 0.05


class Plant:
    """Variables with their values; ``verdicts`` and ``left`` run the engine on them."""

    def __init__(self):
        self.candidates, self.values = [], {}

    def add(self, path, values, unit=None, bounds=None, symbol="", largest=None):
        path = path if isinstance(path, tuple) else ("Plant", path)
        node = f"s={'/'.join(path)}"
        own = unit_of(unit) if unit else None
        self.candidates.append(Candidate(node, path, own, bounds, symbol=symbol, largest=largest))
        self.values[node] = np.asarray(values, float)
        return node

    def verdicts(self, given=None, rating=None, *, assume=False):
        wanted = Wanted(given or {}, rating or Rating(), assume=assume)
        self.groups = group(self.candidates)
        self.groups += possible_valves(self.candidates, self.groups)
        every, self.records = judged(self.groups, lambda _: Record(self.values, STEP), wanted)
        self.all = every
        return [one for one in every if one.reading is not None or one.question is not None]

    def left(self):
        """The variables that the last verdicts do not use, by their last name, with reasons."""
        found = unused(self.candidates, self.groups, self.all, self.records)
        return {one.variable.path[-1]: one.reason for one in found}


@pytest.fixture
def plant():
    return Plant()


@pytest.fixture
def moving():
    """True signals of a valve at work, in %, bar, l/min; another seed is another valve."""

    def signals(seed=0, supply=180.0, k=4.0):
        rng = np.random.default_rng(seed)
        t = np.arange(0, 10, STEP)
        U = 50 + 30 * np.sin((0.9 + 0.3 * seed) * t) + 12 * np.sin(2.3 * t + seed)
        p1 = supply - 0.1 * U + rng.normal(0, 0.2, len(t))
        p2 = 40 + 25 * np.sin(0.7 * t + seed) + rng.normal(0, 0.2, len(t))
        Q = k * (U / 100) ** 1.2 * np.sqrt(p1 - p2) + rng.normal(0, 0.2, len(t))
        return {"t": t, "U": U, "p1": p1, "p2": p2, "Q": Q, "T": 45 + 0 * t}

    return signals
