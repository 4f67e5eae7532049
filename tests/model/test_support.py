"""What a map rests on: where samples were, and whether eq. (7) was enough for them."""

import numpy as np
import pytest

from benchmarks.circumstances import eq7, ordinary
from benchmarks.outside import VALVES
from valvemap.model.samples import Samples, Trace
from valvemap.model.support import Support
from valvemap.vocabulary.statuses import Status

SIGMA = 0.4


def scattered(seed, N, U=(5.0, 40.0), dp=(5.0, 60.0)):
    rng = np.random.default_rng(seed)
    return rng.uniform(*U, N), rng.uniform(*dp, N)


def resting_on(U, dp, Q=None, T=40.0, batches=1, status=Status.OK):
    N = len(U)
    Q = 0.0 * U if Q is None else Q
    samples = Samples.of(np.arange(N), U, dp, 0 * dp, Q, np.full(N, T))
    support = Support.none()
    for rows in np.array_split(np.arange(N), batches):
        nothing = np.zeros(len(rows))
        trace = Trace(nothing, nothing, nothing, np.full(len(rows), status, np.uint8))
        support = support.add(samples[rows], trace)
    return support


def noisy(valve, seed, N, **part):
    U, dp = scattered(seed, N, **part)
    return U, dp, valve(U, dp) + SIGMA * np.random.default_rng(seed + 77).normal(size=N)


def ar(seed, N, rho=0.95):
    e = np.random.default_rng(seed).normal(size=N) * SIGMA * np.sqrt(1 - rho**2)
    out = np.zeros(N)
    for i in range(1, N):
        out[i] = rho * out[i - 1] + e[i]
    return out


def ramps(seed, N, low, high):
    rng, t, x = np.random.default_rng(seed), [0.0], [low]
    while t[-1] < N:
        t += [t[-1] + rng.uniform(40, 300), t[-1] + rng.uniform(301, 400)]
        x += [rng.uniform(low, high)] * 2
    return np.interp(np.arange(N), t, x)


def near(U, dp, T, at):
    close = [
        ((abs(U - u) <= 5) & (abs(dp - p) <= 5) & (abs(T - t) <= 5)).sum()
        for u, p, t in zip(*at, strict=True)
    ]
    return np.array(close) >= 3


def test_three_samples_make_an_inside_of_five_percent_five_bar_and_five_degrees():
    support = resting_on(np.full(3, 50.0), np.full(3, 102.0), T=40.0)
    for U, dp, T, expected in (
        (50.0, 102.0, 40.0, True),
        (54.9, 97.1, 44.7, True),
        (55.2, 102.0, 40.0, False),
        (50.0, 107.3, 40.0, False),
        (50.0, 102.0, 45.6, False),
        (50.0, 102.0, np.nan, True),
    ):
        (d,) = support.distance(*(np.array([x]) for x in (U, dp, T)))
        assert (d <= 1.0) == expected, (U, dp, T, d)
    two = resting_on(np.full(2, 50.0), np.full(2, 102.0))
    assert two.distance(*np.full((3, 1), 50.0))[0] > 1.0
    assert Support.none().distance(*np.full((3, 1), 50.0))[0] == np.inf


@pytest.mark.parametrize(
    "part", [((5, 40), (5, 60)), ((50, 95), (100, 190)), ((20, 80), (20, 150))]
)
def test_scattered_samples_are_remembered_to_a_fraction_of_a_percent(part):
    U, dp = scattered(3, 5000, *part)
    rng = np.random.default_rng(4)
    at = rng.uniform(0, 100, 3000), rng.uniform(0, 200, 3000), np.full(3000, 40.0)
    inside = near(U, dp, 40.0, at)
    called = resting_on(U, dp).distance(*at) > 1.0
    assert np.mean(called[inside]) <= 0.01
    assert np.mean(~called[~inside]) <= 0.01


def test_a_valve_known_cold_and_hot_is_not_known_between():
    U, dp = scattered(3, 4000)
    T = np.where(np.arange(4000) % 2, 25.0, 55.0)
    support = resting_on(U, dp, T=T)
    at = np.full(61, 20.0), np.full(61, 30.0), np.linspace(10, 70, 61)
    inside = (np.abs(at[2] - 25.0) <= 5.0) | (np.abs(at[2] - 55.0) <= 5.0)
    np.testing.assert_array_equal(support.distance(*at) <= 1.0, inside)


def test_what_was_not_learnt_from_counts_nowhere_and_what_is_beyond_the_ranges_does():
    U, dp = np.full(100, 50.0), np.full(100, 100.0)
    for status in (Status.REJECTED, Status.FROZEN, Status.EXTRAPOLATING):
        assert resting_on(U, dp, status=status).distance(*np.full((3, 1), 50.0))[0] == np.inf
    beyond = resting_on(np.full(9, 104.0), np.full(9, 310.0))
    at = (np.array([104.0, 100.0, 98.0]), np.array([311.0, 306.0, 310.0]), np.full(3, 40.0))
    assert (beyond.distance(*at) <= 1.0).tolist() == [True, True, False]


def test_any_cutting_into_batches_gives_the_same_bits():
    U, dp, Q = noisy(ordinary, 1, 12_000)
    whole, parts = resting_on(U, dp, Q), resting_on(U, dp, Q, batches=97)
    for name in ("cells", "fit", "ranges"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(parts, name))


def test_the_memory_is_small():
    support = Support.none()
    assert support.cells.nbytes + support.fit.nbytes + support.ranges.nbytes < 6_300


@pytest.mark.parametrize("name", VALVES)
def test_eq_7_suffices_for_itself_alone(name):
    for seed in range(4):
        support = resting_on(*noisy(VALVES[name], seed, 5000))
        assert support.is_eq7_enough == (name == "eq. (7)") == (not support.is_eq7_refuted)


def test_too_few_samples_or_too_alike_prove_nothing():
    U, dp, Q = noisy(eq7, 1, 40)
    assert not resting_on(U[:9], dp[:9], Q[:9]).is_eq7_enough
    levels = np.where(np.arange(5000) % 2, 10.0, 30.0)  # two of them: a bend in U is not seen
    _, dp = scattered(1, 5000)
    Q = eq7(levels, dp) + SIGMA * np.random.default_rng(2).normal(size=5000)
    assert not resting_on(levels, dp, Q).is_eq7_enough


def test_coloured_noise_on_a_cycle_does_not_look_like_misfit_and_misfit_there_does():
    N = 40_000
    U, dp, noise = ramps(1, N, 0, 100), ramps(2, N, 3, 195), ar(3, N)
    exact, bent = (resting_on(U, dp, valve(U, dp) + noise) for valve in (eq7, ordinary))
    assert exact.is_eq7_enough
    assert bent.is_eq7_refuted
    drifting = eq7(U, dp) * (1.0 - 0.15 * np.arange(N) / 360_000) + noise
    assert not resting_on(U, dp, drifting).is_eq7_refuted
    few = resting_on(U[:4000], dp[:4000], eq7(U, dp)[:4000] + noise[:4000])
    assert not few.is_eq7_enough  # nobody can tell yet
    assert not few.is_eq7_refuted


def test_a_narrow_window_could_hide_a_bend_and_says_how_much():
    far = np.array([100.0]), np.array([200.0])
    wide, narrow = (resting_on(*noisy(eq7, 5, 5000, U=U)) for U in ((5, 40), (20, 25)))
    assert wide.may_hide(*far)[0] < 15.0
    assert narrow.may_hide(*far)[0] > 100.0


def test_the_misfit_of_eq_7_is_known_where_samples_were():
    U, dp, Q = noisy(ordinary, 1, 5000)
    support = resting_on(U, dp, Q)
    at = np.array([10.0, 35.0]), np.array([30.0, 50.0])
    off = support.misfit(*at, ordinary(*at) + np.array([1.0, -0.5]))
    np.testing.assert_allclose(off, [1.0, 0.5], atol=0.2)
