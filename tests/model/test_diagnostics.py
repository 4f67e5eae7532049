import numpy as np
import pytest

from valvemap.model.diagnostics import conditioning, coverage, excitation, whiteness
from valvemap.model.model_structures import FiveTerms
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples
from valvemap.vocabulary.statuses import Quality


def test_white_noise_is_called_white_as_often_as_the_p_value_says():
    p_values = [
        whiteness(np.random.default_rng(seed).normal(size=400)).p_value for seed in range(500)
    ]
    assert 0.02 < np.mean(np.array(p_values) < 0.05) < 0.09


def test_a_moving_average_is_called_coloured_and_its_correlation_is_found():
    e = np.random.default_rng(0).normal(size=5001)
    found = whiteness(e[1:] + 0.8 * e[:-1])
    assert found.p_value < 1e-12
    assert found.correlations[0] == pytest.approx(0.8 / 1.64, abs=0.05)
    assert np.abs(found.correlations[1:]).max() < 0.06


def test_ljung_and_box_by_hand():
    # Mean 0, power 4, ρ(1) = (1·1 - 1·1 + 1·(-1))/4 … of 1, 1, -1, -1.
    found = whiteness([1.0, np.nan, 1.0, -1.0, -1.0], lags=1)
    assert found.correlations.tolist() == [0.25]
    assert found.statistic == pytest.approx(4 * 6 * 0.0625 / 3)


def test_what_cannot_be_tested_is_said():
    assert whiteness(np.zeros(50)).p_value == 1.0
    with pytest.raises(ValueError, match=r"lags = 20; 1 to 2 are allowed for 3 innovations"):
        whiteness([1.0, 2.0, 3.0])


def test_one_level_of_u_excites_three_of_five_combinations():
    dp = np.linspace(1, 200, 100)
    assert excitation(FiveTerms().regressors(np.full(100, 30.0), dp, dp)).rank == 3
    found = excitation(FiveTerms().regressors(np.repeat([30.0, 60.0], 50), dp, dp))
    assert found.rank == 5
    assert 10.0 < found.condition < 1000.0
    assert np.linalg.norm(found.weakest) == pytest.approx(1.0)


def test_few_dull_or_broken_rows_excite_little():
    assert excitation([[1.0, 2.0, 3.0]]).rank == 1
    assert excitation([[0.0, 0.0]]).rank == 0
    assert excitation([[np.nan, 1.0], [np.inf, 0.0]]).rank == 0
    assert excitation([[1.0, 0.0], [0.0, 1e9]]).condition == pytest.approx(1.0)


def test_conditioning_is_infinite_until_theta_is_determined():
    rls = RecursiveLeastSquares()
    rng = np.random.default_rng(0)
    U, dp = rng.uniform(0, 100, 100), rng.uniform(0, 200, 100)
    samples = Samples.of(np.arange(100), U, dp, np.zeros(100), U)
    assert conditioning(rls.initial_state()) == np.inf
    state, _ = rls.update(rls.initial_state(), samples)
    X = FiveTerms().regressors(U, dp, dp)
    assert conditioning(state) == pytest.approx(excitation(X).condition ** 2, rel=1e-6)


def test_coverage_counts_the_good_samples_of_each_cell():
    samples = Samples.of(
        t=range(5),
        U=[5, 5, 95, 50, 150],
        p1=[10, 10, 190, np.nan, 10],
        p2=[0, 0, 0, 0, 0],
        Q=[0, 0, 0, 0, 0],
        quality=[Quality.GOOD, Quality.UNCERTAIN, Quality.GOOD, Quality.GOOD, Quality.GOOD],
    )
    found = coverage(samples)
    assert found.counts[0, 0] == 2
    assert found.counts[9, 9] == 1
    assert found.counts.sum() == 3
    assert found.share == 0.02
    assert coverage(Samples.empty()).share == 0.0
