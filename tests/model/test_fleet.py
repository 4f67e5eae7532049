import numpy as np
import pytest

from valvemap.model.fleet import learn_fleet, member, stack
from valvemap.model.forgetting import Adaptive, Directional, Exponential, SlidingWindow
from valvemap.model.least_squares_learning import learn
from valvemap.model.least_squares_state import initial_state
from valvemap.model.model_structures import FiveTerms

LENGTHS = [300, 0, 1, 700, 42]
OFFSETS = np.cumsum([0, *LENGTHS])


@pytest.fixture
def samples():
    rng = np.random.default_rng(0)
    N = OFFSETS[-1]
    U, dp = rng.uniform(0, 100, N), rng.uniform(0, 200, N)
    X = FiveTerms().regressors(U, dp, dp)
    y = X @ [1.0, 0.02, 0.3, 0.12, -0.01] + rng.normal(size=N)
    y[[5, 400]] = np.nan
    return X, y, np.arange(N), np.ones(N, np.uint8)


RULES = [Exponential(0.99), Directional(0.99), Adaptive(), SlidingWindow(10)]


@pytest.mark.parametrize("rule", RULES, ids=repr)
def test_a_fleet_learns_what_its_members_learn_alone_to_the_bit(rule, samples):
    fleet = stack([initial_state(5, rule)] * len(LENGTHS))
    after, trace = learn_fleet(fleet, rule, *samples, OFFSETS)
    for m in range(len(LENGTHS)):
        own = slice(OFFSETS[m], OFFSETS[m + 1])
        alone, alone_trace = learn(initial_state(5, rule), rule, *(a[own] for a in samples))
        for name, array in vars(alone).items():
            np.testing.assert_array_equal(getattr(member(after, m), name), array)
        np.testing.assert_array_equal(trace.residual[own], alone_trace.residual)
        np.testing.assert_array_equal(trace.status[own], alone_trace.status)
    assert not fleet.theta.any()


def test_what_does_not_fit_is_refused(samples):
    fleet = stack([initial_state(5, Exponential(0.99))] * 2)
    for offsets in ([0, 10], [0, 10, 5], [1, 5, len(samples[1])]):
        with pytest.raises(ValueError, match="3 ascending ones are wanted"):
            learn_fleet(fleet, Exponential(0.99), *samples, offsets)
