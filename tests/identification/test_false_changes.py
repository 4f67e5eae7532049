"""A plant that stays is never called changed, and one that loses 10 % is, soon."""

import pytest

from benchmarks import circumstances as honest
from benchmarks import honest_maps as bench
from service.identification.auto import Auto

ESTIMATORS = {"RLS": bench.RLS, "Auto": Auto()}
SEEDS = range(600, 620)


@pytest.mark.soak
@pytest.mark.timeout(6 * 3600)
@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("valve", bench.VALVES)
def test_twenty_seeds_of_healthy_samples_raise_no_change(estimator, valve):
    of = ESTIMATORS[estimator]
    found = []
    for seed in SEEDS:
        for name, stream in bench.healthy(bench.VALVES[valve], seed):
            state, _ = of.update(of.initial_state(), honest.samples_of(*stream))
            change = of.last_change(state)
            if change is not None:
                found.append((seed, name, change.count))
    assert found == []


def test_damage_on_a_cycle_is_found_soon_where_the_structure_misfits_too():
    """Within 100 samples that show it on most machines: a place must have been seen before."""
    for valve in (honest.ordinary, honest.s_shape, honest.saturating):
        delays = [bench.damage(valve, seed, honest.cycle) for seed in range(320, 332)]
        soon = [delay for delay in delays if delay != "not" and int(delay) <= 100]
        assert len(soon) >= 7, delays
