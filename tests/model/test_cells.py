"""Cells of a map: a slot each as long as there are slots, then the likest of a place become one."""

from dataclasses import replace

import numpy as np
import pytest

from valvemap.model.auto import Auto
from valvemap.model.estimator import StateMismatchError
from valvemap.model.kernels import cells as memory
from valvemap.model.kernels import grid
from valvemap.model.samples import Samples


def scattered(seed, N, T, most=390):
    rng = np.random.default_rng(seed)
    U, dp = rng.uniform(0, 100, N), rng.uniform(1, most, N)
    T = np.broadcast_to(np.asarray(T, float), N)
    Q = 0.1 * U * np.sqrt(dp) * (1 + 2e-3 * (T - 40)) + 0.1 * rng.normal(size=N)
    return Samples.of(10_000_000 * np.arange(N), U, dp, 0 * dp, Q, T)


def learnt(*parts):
    auto = Auto(lag_U=0.0, lag_Q=0.0)
    state = auto.initial_state()
    for part in parts:
        state, _ = auto.update(state, part)
    return auto, state


def places_of(state):
    slot_at, cells = grid.slot_at.py_func, grid.PLACES * grid.CELLS_OF_A_PLACE
    found = np.array([slot_at(number, state.slots) for number in range(cells)])
    return found.reshape(grid.PLACES, grid.CELLS_OF_A_PLACE)


def test_a_cell_has_a_slot_of_its_own_while_there_are_any():
    _, state = learnt(scattered(0, 300, 40.0))
    taken = places_of(state)[places_of(state) > 0]
    assert len(taken) == len(set(taken.tolist())) == state.counters[memory.TAKEN] < grid.SLOTS
    assert (state.cells[:, grid.WEIGHT] > 0).sum() == len(taken)


def test_with_more_cells_than_slots_no_sample_is_lost_and_no_slot_serves_two_places():
    rng = np.random.default_rng(3)
    _, state = learnt(scattered(1, 20_000, rng.uniform(20, 60, 20_000)))
    assert state.counters[memory.TAKEN] == grid.SLOTS
    places = [set(row[row > 0].tolist()) for row in places_of(state)]
    assert sum(len(slots) for slots in places) == len(set().union(*places)) <= grid.SLOTS
    visited = (places_of(state) > 0).any(axis=1)
    assert visited.sum() > 400
    held = state.cells[places_of(state)[visited].max(axis=1) - 1, grid.WEIGHT]
    assert (held > 0).all()


def test_a_state_whose_slots_serve_cells_of_two_places_or_none_is_refused():
    auto, state = learnt(scattered(0, 300, 40.0))
    state.check(auto.initial_state())
    heads, links = state.slots[: grid.PLACES], state.slots[grid.PLACES :]
    first, second = np.flatnonzero(heads)[:2]
    for place, link in ((first, 0), (first, links[heads[first] - 1] | grid.NEXT)):
        damaged = replace(state, slots=state.slots.copy())
        damaged.slots[grid.PLACES + heads[place] - 1] = link
        with pytest.raises(StateMismatchError, match="do not belong together"):
            damaged.check(auto.initial_state())
    damaged = replace(state, slots=state.slots.copy())
    damaged.slots[second] = damaged.slots[first]
    with pytest.raises(StateMismatchError, match="do not belong together"):
        damaged.check(auto.initial_state())


def test_directions_are_made_one_before_temperatures_where_no_loop_is_known():
    _, state = learnt(scattered(4, 12_000, 40.0, 100), scattered(5, 6_000, 60.0, 100))
    cells = state.cells[state.cells[:, grid.WEIGHT] > 0]
    assert state.counters[memory.TAKEN] == grid.SLOTS
    mixed = (cells[:, grid.MEAN_T] > 41) & (cells[:, grid.MEAN_T] < 59)
    assert not mixed.any()
    assert (np.abs(cells[:, grid.DIRECTION]) < 0.9).mean() > 0.3


def test_what_is_known_at_one_temperature_is_not_held_against_another():
    auto, state = learnt(scattered(6, 8_000, 40.0))
    state, _ = auto.update(state, scattered(7, 3_000, 60.0))
    assert auto.change_counts(state) == 0
    U, dp = np.array([30.0, 80.0]), np.array([60.0, 150.0])
    for T in (40.0, 60.0):
        Q, _ = auto.predict(state, U, dp, np.full(2, T))
        np.testing.assert_allclose(Q, 0.1 * U * np.sqrt(dp) * (1 + 2e-3 * (T - 40)), atol=0.15)


def colour_of(errors):
    scalars = np.zeros(memory.SCALARS)
    scalars[memory.NOISE], scalars[memory.LAST_BUT_ONE] = 1.0, np.nan
    for error in errors:
        memory._know_colour.py_func(error, 1, scalars)
    return memory.colour(scalars)


def test_a_smooth_misfit_is_no_coloured_noise():
    rng, N = np.random.default_rng(5), 6_000
    white = rng.normal(size=N)
    misfit = 8.0 * np.sin(np.arange(N) / 60.0)
    noise = np.zeros(N)
    for i in range(1, N):
        noise[i] = 0.95 * noise[i - 1] + np.sqrt(1 - 0.95**2) * white[i]
    assert colour_of(white) < 0.1
    assert colour_of(white + misfit) < 0.4
    assert colour_of(noise) > 0.92


def held_at(U, dp, scale=1.0, seed=0):
    """Samples of one path, each σ = .4 off .14·U·√Δp, all of whose flow is scaled."""
    rng = np.random.default_rng(seed)
    U, dp = (np.asarray(x, float) for x in np.broadcast_arrays(U, dp))
    return U, dp, scale * 0.14 * U * np.sqrt(dp) + 0.4 * rng.normal(size=len(U))


def one_after_another(*parts):
    U, dp, Q = (np.concatenate(x) for x in zip(*parts, strict=True))
    return Samples.of(10_000_000 * np.arange(len(U)), U, dp, 0 * dp, Q, np.full(len(U), 40.0))


def all_places(but, seed=1, N=6_000):
    """U and Δp drawn anew for every sample, but for some places."""
    rng = np.random.default_rng(seed)
    U, dp = rng.uniform(0, 100, N), rng.uniform(2, 190, N)
    left = ~but(U, dp)
    return held_at(U[left], dp[left], seed=seed)


def found_after(before, after):
    """How many samples after a change of the flow it is found; None: it is not."""
    samples, n = one_after_another(before, after), len(before[0])
    auto, state = learnt(samples[:n])
    assert auto.change_counts(state) == 0
    for k in range(n, len(samples), 5):
        state, _ = auto.update(state, samples[k : k + 5])
        if auto.change_counts(state):
            return k + 5 - n
    return None


def one_place_wide(U, dp):
    return (U > 40.0) & (U < 44.5) & (dp > 60.0) & (dp < 150.0)


def test_damage_is_found_in_places_that_are_new_if_the_map_is_seen_to_fit_around():
    path = np.linspace(40.8, 43.6, 120), np.linspace(75.0, 135.0, 120)
    late = found_after(all_places(one_place_wide), held_at(*path, scale=0.9, seed=2))
    assert late is not None
    assert late <= 100
    assert found_after(all_places(one_place_wide), held_at(*path, seed=2)) is None


def test_beyond_all_that_is_known_nothing_is_called_damage():
    def beyond(U, dp):
        return U > 60.0

    path = np.linspace(63.0, 90.0, 600), np.linspace(30.0, 120.0, 600)
    assert found_after(all_places(beyond), held_at(*path, scale=0.9, seed=3)) is None


def test_damage_is_found_in_a_long_stay_in_one_cell_in_which_the_flow_moves():
    known = all_places(lambda U, _: U < 0.0, N=20_000)
    path = np.linspace(44.0, 46.6, 90), np.linspace(102.0, 125.0, 90)
    late = found_after(known, held_at(*path, scale=0.9, seed=4))
    assert late is not None
    assert late <= 60
    assert found_after(known, held_at(*path, seed=4)) is None
