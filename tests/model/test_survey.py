from dataclasses import dataclass

import numpy as np
import pytest

from support.plant import plant
from valvemap.model.flow_map import FlowMap
from valvemap.model.forgetting import Adaptive, Exponential
from valvemap.model.maximum_likelihood import MaximumLikelihood
from valvemap.model.model_structures import FiveTerms
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.residual_spread import ResidualSpread
from valvemap.model.samples import Samples
from valvemap.model.survey import survey
from valvemap.model.tensor_spline import TensorSpline

WHERE = {
    "a low U": (0, 40, 10, 200),
    "low pressure drops": (0, 100, 5, 40),
    "the middle": (30, 60, 50, 100),
    "the whole map": (0, 100, 2, 200),
}
GRID_U, GRID_DP = (
    x.ravel() for x in np.meshgrid(np.linspace(0, 100, 21), np.linspace(10, 200, 20))
)


def samples_from(U, dp, rng, first=0):
    Q = 0.14 * U * np.sqrt(dp) + 0.4 * rng.normal(size=len(U))
    return Samples.of(first + np.arange(len(U)), U, dp, 0 * dp, Q, np.full(len(U), 40.0))


def learnt(estimator, where, n=500, seed=0):
    rng = np.random.default_rng(seed)
    low_U, high_U, low_dp, high_dp = WHERE[where]
    samples = samples_from(rng.uniform(low_U, high_U, n), rng.uniform(low_dp, high_dp, n), rng)
    state, trace = estimator.update(estimator.initial_state(), samples)
    return state, ResidualSpread.none().add(samples, trace)


def variance_of_map(estimator, state):
    """Mean variance of Q̂ over that of the noise, so that no luck with σ² counts."""
    P = np.linalg.inv(estimator.information(state))
    X = estimator.structure.regressors(GRID_U, GRID_DP, GRID_DP)
    return float(((X @ P) * X).sum(axis=1).mean())


@pytest.mark.parametrize("where", WHERE)
@pytest.mark.parametrize("structure", [FiveTerms(), TensorSpline.uniform(6, 4)])
def test_the_variance_falls_three_times_faster_by_suggested_points_than_by_random_ones(
    structure, where
):
    """What five suggested samples do, fifteen random ones do not (mean of 20 random runs)."""
    estimator = RecursiveLeastSquares(structure, Exponential(1.0))
    start, spread = learnt(estimator, where)
    rng, state = np.random.default_rng(1), start
    for k in range(5):
        found = survey(estimator, state, spread, 0)
        at = np.array([found.suggested_U]), np.array([found.suggested_dp])
        state, _ = estimator.update(state, samples_from(*at, rng, 1000 + k))
    suggested = variance_of_map(estimator, state)
    random = []
    for _ in range(20):
        points = samples_from(rng.uniform(0, 100, 15), rng.uniform(10, 200, 15), rng, 1000)
        random.append(variance_of_map(estimator, estimator.update(start, points)[0]))
    before = variance_of_map(estimator, start)
    assert suggested < before
    assert suggested < np.mean(random)


@pytest.mark.parametrize(
    "estimator",
    [RecursiveLeastSquares(forgetting=Adaptive()), MaximumLikelihood(), FlowMap(), RbfNetwork()],
    ids=["RLS", "RML", "Auto", "RBF"],
)
def test_whoever_saw_a_low_U_alone_is_sent_to_a_high_one(estimator):
    state, spread = learnt(estimator, "a low U", 1500)
    assert survey(estimator, state, spread, 0).suggested_U > 60.0


def test_before_any_sample_there_is_a_suggestion_and_nothing_is_known():
    for estimator in (RecursiveLeastSquares(), MaximumLikelihood(), FlowMap(), RbfNetwork()):
        found = survey(estimator, estimator.initial_state(), ResidualSpread.none(), 0)
        assert 0 <= found.suggested_U <= 100
        assert 0 < found.suggested_dp <= 200
        assert np.isnan(found.std).all()
        assert np.isnan(found.age_s).all()
        assert found.share == 0.0
        assert not found.condition < np.inf


def test_one_level_of_U_leaves_a_direction_open_and_the_suggestion_closes_it():
    rls, rng = RecursiveLeastSquares(), np.random.default_rng(0)
    dp = rng.uniform(10, 200, 200)
    samples = samples_from(np.full(200, 30.0), dp, rng)
    state, trace = rls.update(rls.initial_state(), samples)
    spread = ResidualSpread.none().add(samples, trace)
    found = survey(rls, state, spread, 0)
    assert found.condition == np.inf
    assert found.suggested_U in (0.0, 100.0)
    for k in range(2):  # an offset and a slope of U are open
        found = survey(rls, state, spread, 0)
        at = np.array([found.suggested_U]), np.array([found.suggested_dp])
        state, _ = rls.update(state, samples_from(*at, rng, 300 + k))
    assert np.isfinite(survey(rls, state, spread, 0).condition)


def test_the_age_of_a_region_is_the_time_since_its_last_sample():
    rls = RecursiveLeastSquares()
    samples = Samples.of([0, 10**9], [5.0, 95.0], [100.0, 100.0], [0.0, 0.0], [1.0, 90.0])
    spread = ResidualSpread.none().add(
        samples, type(rls.update(rls.initial_state(), samples)[1])(*np.ones((3, 2)), np.zeros(2))
    )
    found = survey(rls, rls.initial_state(), spread, 4 * 10**9)
    assert found.age_s[0, 6] == 4.0
    assert found.age_s[9, 6] == 3.0
    assert np.isfinite(found.age_s).sum() == 2
    assert found.share == 0.02


def test_a_flow_that_the_pump_cannot_deliver_is_not_suggested():
    rls = RecursiveLeastSquares()
    state, spread = learnt(rls, "the middle")
    free = survey(rls, state, spread, 0)
    bound = survey(rls, state, spread, 0, Q_max=60.0)
    assert 0.14 * free.suggested_U * np.sqrt(free.suggested_dp) > 100.0
    assert 0.14 * bound.suggested_U * np.sqrt(bound.suggested_dp) < 61.0


@dataclass(frozen=True)
class Broken(RecursiveLeastSquares):
    """One whose information has left the range of numbers."""

    number: float = np.nan

    def information(self, _state):
        return np.full((5, 5), self.number)


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf, 1e308, -1e308, 0.0])
def test_a_survey_without_a_covariance_suggests_a_place_and_says_that_one_is_open(number):
    rls, samples = Broken(number=number), plant(500)
    state, trace = rls.update(rls.initial_state(), samples)
    found = survey(rls, state, ResidualSpread.none().add(samples, trace), 0)
    assert found.condition == np.inf
    assert 0.0 <= found.suggested_U <= 100.0
    assert 0.0 <= found.suggested_dp <= 200.0
