"""`Auto` fits on a budget: dense while a map is young, rare later, by its own samples alone."""

from dataclasses import fields

import numpy as np

from valvemap.model import fit_budget as budget
from valvemap.model.auto import Auto
from valvemap.model.fleet import member, repeated
from valvemap.model.kernels import cells as memory
from valvemap.model.kernels import grid
from valvemap.model.samples import Samples, Segments


def recording(seed, N):
    rng = np.random.default_rng(seed)
    U, dp = rng.uniform(0, 100, N), rng.uniform(2, 198, N)
    Q = 0.13 * np.clip(U - 6, 0, None) * np.sqrt(dp) + 0.4 * rng.normal(size=N)
    return Samples.of(10_000_000 * np.arange(N), U, dp, 0 * dp, Q)


def test_what_is_spent_stays_within_what_the_samples_grant():
    auto = Auto()
    state, samples = auto.initial_state(), recording(0, 20_000)
    spent = []
    for start in range(0, 20_000, 1000):
        state, _ = auto.update(state, samples[start : start + 1000])
        spent.append(int(state.counters[memory.SPENT]))
    young = budget.YOUNG * budget.YOUNG_NS
    most = young + budget.SETTLED_NS * np.arange(0, 20_000, 1000)
    fits = 20 * budget.cost(grid.SLOTS, 160, 31)
    assert (np.array(spent) <= most + fits).all()
    assert spent[-1] - spent[-2] <= budget.SETTLED_NS * 1000 + fits


def test_a_state_is_small_and_a_map_stays_good():
    auto = Auto()
    state, trace = auto.update(auto.initial_state(), recording(1, 10_000))
    assert sum(np.asarray(getattr(state, f.name)).nbytes for f in fields(state)) <= 70_000
    assert np.std(trace.residual[-1000:]) < 0.44


def test_valves_side_by_side_learn_what_each_learns_alone():
    auto = Auto()
    parts = [recording(seed, 1500) for seed in range(3)]
    alone = [auto.update(auto.initial_state(), part)[0] for part in parts]
    together = repeated(auto.initial_state(), 3)
    for start in range(0, 1500, 125):
        batch = Samples.concatenate([part[start : start + 125] for part in parts])
        edges = 125 * np.arange(4)
        auto.update_many(together, batch, Segments(np.arange(3), edges[:-1], edges[1:]))
    for m, state in enumerate(alone):
        for field in fields(state):
            found = getattr(member(together, m), field.name)
            assert found.tobytes() == getattr(state, field.name).tobytes(), field.name


def test_a_change_is_told_with_its_time_and_size():
    auto, N = Auto(), 12_000
    samples = recording(2, N)
    changed = samples.Q * np.where(np.arange(N) >= 11_000, 0.9, 1.0)
    worn = Samples.of(samples.t, samples.U, samples.p1, samples.p2, changed)
    state, _ = auto.update(auto.initial_state(), worn[:11_000])
    assert auto.last_change(state) is None
    state, _ = auto.update(state, worn[11_000:11_100])
    change = auto.last_change(state)
    assert change is not None
    assert change.count == 1
    assert 10_990 <= change.sample <= 11_010
    assert change.t == samples.t[change.sample - 1]
    assert change.size < -2.0
