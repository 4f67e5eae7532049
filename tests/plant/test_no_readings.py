"""Numbers that stand for no reading are told from readings."""

import numpy as np
import pytest

from valvemap.plant.no_readings import no_readings

N = 4_000


def plant(seed=1):
    rng = np.random.default_rng(seed)
    t = np.arange(N) / 50
    U, p2 = 50 + 45 * np.sin(0.8 * t), 60 + 40 * np.sin(0.37 * t)
    Q = 0.04 * U * np.sqrt(190 - p2) + rng.normal(0, 0.1, N)
    return {"U": U, "p1": 190 + rng.normal(0, 0.2, N), "p2": p2, "Q": Q}


@pytest.mark.parametrize("number", [0.0, -999.0, 9_999.0, -0.125])
def test_each_signal_is_judged_by_its_own_jumps(number):
    rng, values, counts = np.random.default_rng(2), plant(), {}
    for name in values:
        gone = rng.random(N) < 0.02
        values[name] = np.where(gone, number, values[name])
        counts[name] = int(gone.sum())
    assert {x.signal: (x.number, x.samples) for x in no_readings(values)} == {
        name: (number, count) for name, count in counts.items()
    }


def test_readings_are_none():
    values = plant()
    assert no_readings(values) == []
    coarse = {name: np.round(x) for name, x in values.items()}
    assert no_readings(coarse) == []
    shut = values | {"U": np.where(values["U"] < 30, 0.0, values["U"])}
    assert no_readings(shut) == []
    empty = {name: np.full(N, np.nan) for name in values}
    assert no_readings(empty) == []
    assert no_readings({name: x[:1] for name, x in values.items()}) == []


def test_commands_drawn_anew_for_each_sample_are_readings():
    rng = np.random.default_rng(3)
    U = 25.0 * rng.integers(0, 5, 50_000)
    p2 = rng.uniform(10, 180, len(U))
    assert (
        no_readings({"U": U, "p1": 0 * U + 190, "p2": p2, "Q": 0.04 * U * np.sqrt(190 - p2)}) == []
    )
