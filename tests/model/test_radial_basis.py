"""Radial basis functions with fixed centres: as good as splines, on sorted data too."""

import numpy as np
import pytest

from valvemap.errors import ConfigurationError
from valvemap.model.maximum_likelihood import MaximumLikelihood
from valvemap.model.model_structures import FiveTerms, StructureWithPrior
from valvemap.model.radial_basis import RadialBasis
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples
from valvemap.model.tensor_spline import TensorSpline

SIGMA = 0.4  # l/min, 0.2 % of 200


def bent_gain(U, dp):
    opening = np.clip((U - 5.0) / 95.0, 0.0, None)
    return 230.0 * opening**1.2 * np.sqrt(dp / 200.0) * (1.0 + 0.1 * np.tanh((dp - 60.0) / 60.0))


def s_shaped(U, dp):
    x = U / 100.0
    gain = 0.15 * x + 0.85 * x**2 * (3.0 - 2.0 * x)
    return 210.0 * gain * np.sqrt(dp / 200.0) * (1.0 + 0.08 * np.sin(dp / 50.0))


def dead_band(U, dp):
    return 210.0 * np.clip((U - 8.0) / 92.0, 0.0, None) * np.sqrt(dp / 200.0) - 0.01 * dp


def scattered(N=12_600):
    rng = np.random.default_rng(1)
    return rng.uniform(0, 100, N), rng.uniform(0, 200, N)


def structured(levels=21, each=600):
    sweep = 100.0 - 100.0 * np.cos(2 * np.pi * np.arange(each) / each)
    return np.repeat(np.linspace(0, 100, levels), each), np.tile(sweep, levels)


GRID = tuple(a.ravel() for a in np.meshgrid(np.linspace(0, 100, 41), np.linspace(0, 200, 41)))


def map_rmse(structure, valve, points, estimator=RecursiveLeastSquares):
    U, dp = points
    Q = valve(U, dp) + SIGMA * np.random.default_rng(2).normal(size=len(U))
    one_pass = estimator(structure=structure)
    samples = Samples.of(t=np.arange(len(U)), U=U, p1=dp, p2=0 * dp, Q=Q)
    state, _ = one_pass.update(one_pass.initial_state(), samples)
    theta = one_pass.parameters(state)[0][: len(structure.parameter_names)]
    error = structure.regressors(*GRID, GRID[0]) @ theta - valve(*GRID)
    return np.sqrt(np.mean(error**2))


@pytest.mark.parametrize("points", [scattered(), structured()], ids=["scattered", "structured"])
@pytest.mark.parametrize("valve", [bent_gain, s_shaped, dead_band])
def test_it_converges_on_both_data_types_and_is_as_good_as_the_spline(valve, points):
    error = map_rmse(RadialBasis.uniform(6, 4), valve, points)
    assert error <= 2.0 * map_rmse(TensorSpline.uniform(6, 4), valve, points)
    assert error <= SIGMA
    assert error <= 0.3 * map_rmse(FiveTerms(), valve, points)


def test_maximum_likelihood_finds_it_too():
    assert map_rmse(RadialBasis.uniform(4, 3), s_shaped, structured(), MaximumLikelihood) < SIGMA


def test_its_order_of_samples_does_not_matter():
    U, dp = structured()
    shuffled = np.random.default_rng(3).permutation(len(U))
    errors = [
        map_rmse(RadialBasis.uniform(), bent_gain, points)
        for points in ((U, dp), (U[shuffled], dp[shuffled]))
    ]
    assert errors[0] == pytest.approx(errors[1], rel=0.2)  # not the same noise to each sample


def test_a_gaussian_is_1_at_its_centre_and_exp_of_minus_a_half_one_width_away():
    structure = RadialBasis(U=(0.0, 50.0), s=(0.0, 5.0), width=1.0)
    at = structure.regressors(np.array([0.0, 50.0]), np.array([0.0, 25.0]), np.zeros(2))
    half = np.exp(-0.5)
    np.testing.assert_allclose(at[0, 5:], [1.0, half, half, half**2])
    np.testing.assert_allclose(at[1, 5:], [half**2, half, half, 1.0])
    assert at[1, :5].tolist() == [1.0, 50.0, 5.0, 250.0, 25.0]


def test_beyond_the_grid_it_is_eq_7():
    structure = RadialBasis.uniform()
    far = structure.regressors(np.array([1e4]), np.array([-1e6]), np.zeros(1))
    assert (far[0, 5:] == 0.0).all()
    assert far[0, 2] == -1e3


def test_rows_depend_on_their_own_point_alone():
    structure = RadialBasis.uniform()
    U, dp = scattered(50)
    together = structure.regressors(U, dp, U)
    for i in range(50):
        alone = structure.regressors(U[i : i + 1], dp[i : i + 1], U[i : i + 1])
        assert alone.tobytes() == together[i : i + 1].tobytes()


def test_anything_goes_in_without_a_warning():
    anything = np.array([0.0, np.nan, np.inf, -np.inf, 1e308, -1e308, 1e-308])
    rows = RadialBasis.uniform().regressors(anything, anything, anything)
    assert np.isfinite(rows[0]).all()
    assert not np.isfinite(rows[1]).all()


def test_names_and_prior_fit_the_rows():
    structure = RadialBasis.uniform(3, 2)
    assert isinstance(structure, StructureWithPrior)
    assert len(set(structure.parameter_names)) == 5 + 6 * 5
    rows, values = structure.prior()
    assert rows.shape == (30, 35)
    assert (rows[:, :5] == 0.0).all()
    assert (values == 0.0).all()


@pytest.mark.parametrize(
    ("setting", "word"),
    [
        ({"U": (0.0,)}, "U = "),
        ({"U": (0.0, 1.0, 3.0)}, "U = "),
        ({"s": (1.0, 0.0)}, "s = "),
        ({"s": (0.0, np.nan)}, "s = "),
        ({"width": 0.0}, "width = 0"),
        ({"smoothness": -1.0}, "smoothness = -1"),
    ],
)
def test_settings_without_meaning_are_refused_by_name(setting, word):
    with pytest.raises(ConfigurationError, match=word):
        RadialBasis(**{"U": (0.0, 1.0), "s": (0.0, 1.0), **setting})
