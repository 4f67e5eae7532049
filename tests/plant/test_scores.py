"""Readings of one valve share what does not depend on their units."""

from collections import Counter

import numpy as np

from valvemap.plant.scores import Scores


def test_variables_that_are_not_taken_are_judged_once_for_all_units(plant, monkeypatch):
    rng = np.random.default_rng(1)
    U, dp = rng.uniform(0, 100, 200), rng.uniform(20, 150, 200)
    for name, values in {
        "Stellwert": U,
        "Druck vor Ventil": dp + 5,
        "Druck nach Ventil": 0 * dp + 5,
        "Volumenstrom": 0.1 * U * dp**0.5,
        "Volumenstrom Mittel": 0 * U,
    }.items():
        plant.add(name, values)  # no unit: many scales are tried
    judged, scored = Counter(), Counter()
    of_ranges, of_reading = Scores._judged_ranges, Scores.reading

    def names_of(nodes):
        return tuple((role, one.node) for role, one in nodes.items())

    def count_ranges(self, nodes):
        judged[names_of(nodes)] += 1
        return of_ranges(self, nodes)

    def count_reading(self, nodes, *given, **more):
        scored[names_of(nodes)] += 1
        return of_reading(self, nodes, *given, **more)

    monkeypatch.setattr(Scores, "_judged_ranges", count_ranges)
    monkeypatch.setattr(Scores, "reading", count_reading)
    assert plant.verdicts(assume=True)
    assert set(judged.values()) == {1}
    assert max(scored.values()) > 10
