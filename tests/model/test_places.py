"""The memory of places."""

from dataclasses import fields

import numpy as np

from valvemap.model.forgetting import Adaptive
from valvemap.model.kernels import place_clock
from valvemap.model.kernels import place_layout as layout
from valvemap.model.kernels.row_layout import CLOCK, PLACES_OF_DETECTOR
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples

RLS = RecursiveLeastSquares(forgetting=Adaptive())


def swept(N, first=0):
    """N samples of a valve whose U and dp go up and down."""
    k = np.arange(first, first + N)
    U, dp = 50.0 + 48.0 * np.sin(k / 300.0), 100.0 + 80.0 * np.sin(k / 110.0)
    e = np.random.default_rng(first).normal(size=N)
    return Samples.of(k, U, dp, 0.0 * dp, 0.1 * np.maximum(U - 6.0, 0.0) * np.sqrt(dp) + 0.4 * e)


def later(state, samples):
    """The same state so many samples later by the clock of places."""
    row, nodes = state.row.copy(), state.places.astype(np.float64)
    row[state._places.detector + CLOCK] += samples
    nodes[:, [layout.TOUCHED, layout.VISITED]] += samples
    kept = {f.name: getattr(state, f.name) for f in fields(state)}
    return type(state)(**{**kept, "row": row, "places": nodes.astype(np.float32)})


def test_the_clock_of_places_stands_while_the_valve_rests():
    s, g = np.zeros(PLACES_OF_DETECTOR), 0
    for count in range(0, 1_000_000, 8):
        place_clock.tick.py_func(s, g, 3.0, 4.0, float(count))
    assert s[CLOCK] == place_clock.REST
    for count in range(1_000_000, 1_008_000, 8):
        place_clock.tick.py_func(s, g, 3.0 + 1e-4 * (count - 1_000_000), 4.0, float(count))
    assert 7_400 <= s[CLOCK] - place_clock.REST <= 8_000


def test_a_clock_that_is_set_back_changes_no_age_however_the_samples_are_cut():
    state, _ = RLS.update(RLS.initial_state(), swept(20_000))
    ahead = swept(20_000, 20_000)
    after, trace = RLS.update(state, ahead)
    for parts in (1, 7):
        other, residuals = later(state, place_clock.LATE - 30_000.0), []
        for rows in np.array_split(np.arange(len(ahead)), parts):
            other, said = RLS.update(other, ahead[slice(rows[0], rows[-1] + 1)])
            residuals.append(said.residual)
        assert other.detector[CLOCK] < place_clock.LATE / 2 + 20_000
        assert np.concatenate(residuals).tobytes() == trace.residual.tobytes()
        back = place_clock.LATE - 30_000.0 - place_clock.BACK
        assert other.detector[CLOCK] - back == after.detector[CLOCK]
        known = after.visits[:, layout.VISITS] > 0
        ages = (state.detector[CLOCK] - state.places[:, layout.TOUCHED] for state in (after, other))
        np.testing.assert_array_equal(*(age[known] for age in ages))


def test_the_age_of_a_place_is_right_after_years():
    s, stamps = np.zeros(PLACES_OF_DETECTOR), np.zeros((3, layout.FIELDS), np.float32)
    years = 2_000  # times that the clock is set back: 970 days at 100 Hz
    for k in range(years):
        s[CLOCK] = place_clock.LATE
        stamps[1 if k < years - 1 else 2, layout.TOUCHED] = place_clock.LATE - 1.0
        place_clock.set_back.py_func(s, 0, stamps)
    ages = s[CLOCK] - stamps[:, layout.TOUCHED].astype(np.float64)
    np.testing.assert_allclose(
        ages, [years * place_clock.BACK + place_clock.BACK, place_clock.BACK + 1.0, 1.0], rtol=1e-6
    )


def test_visits_beyond_those_that_are_counted_change_nothing_but_their_number():
    state, _ = RLS.update(RLS.initial_state(), swept(20_000))
    state.visits[:, layout.VISITS] = np.minimum(state.visits[:, layout.VISITS], 1) * layout.MANY
    after, _ = RLS.update(state, swept(20_000, 20_000))
    known = state.visits[:, layout.VISITS] > 0
    assert (after.visits[known, layout.VISITS] == layout.MANY).all()
    assert after.visits[:, layout.STAYED].max() <= layout.APART


def test_the_memory_of_places_takes_six_kilobytes():
    state = RLS.initial_state()
    assert state.flows.nbytes + state.places.nbytes + state.visits.nbytes < 6_200
