"""Plants in memory: what browsing returned, and ten seconds of values."""

import numpy as np
import pytest

from valvemap.pipeline.units import unit_of
from valvemap.plant.candidates import Candidate
from valvemap.plant.grouping import group
from valvemap.plant.reading import Given, Record
from valvemap.plant.verdict import judge

STEP = 0.05


class Plant:
    """Variables with their values; ``judge`` runs the engine on them."""

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
        given = given or {}
        found = group(self.candidates)
        record = Record(self.values, STEP)
        return [
            judge(one, record, given.get(one.name, Given(assume=assume)), rating) for one in found
        ]


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
