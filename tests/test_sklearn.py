import numpy as np
import pytest

pytest.importorskip("sklearn")

from sklearn.base import clone
from sklearn.model_selection import cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.utils.estimator_checks import parametrize_with_checks

from valvemap.model.forgetting import Adaptive, Directional
from valvemap.model.least_squares import batch_least_squares
from valvemap.model.model_structures import FiveTerms, TensorSpline
from valvemap.sklearn import FlowMapRegressor


@pytest.fixture
def valve():
    rng = np.random.default_rng(0)
    X = np.column_stack([rng.uniform(0, 100, 500), rng.uniform(0, 200, 500)])
    return X, 1.0 + 0.12 * X[:, 0] * np.sqrt(X[:, 1]) + rng.normal(size=500)


@parametrize_with_checks(
    [
        FlowMapRegressor(),
        FlowMapRegressor(forgetting=0.999, p0=1e6),
        FlowMapRegressor(forgetting=Adaptive()),
    ]
)
@pytest.mark.filterwarnings("ignore")
def test_scikit_learn_finds_nothing_to_object_to(estimator, check):
    check(estimator)


def test_fit_is_batch_least_squares_on_eq_7(valve):
    X, Q = valve
    rows = FiveTerms().regressors(X[:, 0], X[:, 1], X[:, 1])
    model = FlowMapRegressor().fit(X, Q)
    np.testing.assert_allclose(model.theta_, batch_least_squares(rows, Q), rtol=1e-9)
    Q_hat, std = model.predict(X, return_std=True)
    np.testing.assert_allclose(Q_hat, rows @ model.theta_)
    assert 0.03 < std.min() < std.max() < 0.3


@pytest.mark.parametrize("features", [1, 2, 3, 7])
def test_any_number_of_features_will_do(features):
    rng = np.random.default_rng(1)
    X = rng.uniform(1, 2, (200, features))
    y = 3.0 - X[:, 0] + (X[:, 2:] @ np.arange(1, features - 1) if features > 2 else 0.0)
    np.testing.assert_allclose(FlowMapRegressor().fit(X, y).predict(X), y, atol=1e-8)


def test_in_parts_it_learns_the_same_to_the_bit(valve):
    X, Q = valve
    whole = FlowMapRegressor(forgetting=Directional(0.99)).fit(X, Q)
    parts = clone(whole)
    for i in range(0, 500, 70):
        parts.partial_fit(X[i : i + 70], Q[i : i + 70])
    np.testing.assert_array_equal(parts.theta_, whole.theta_)


def test_it_takes_any_structure_and_stands_in_a_pipeline(valve):
    X, Q = valve
    model = make_pipeline(FlowMapRegressor(structure=TensorSpline.uniform(3, 3)))
    assert cross_val_score(model, X, Q).mean() > 0.99


def test_a_structure_without_a_pressure_drop_is_refused(valve):
    with pytest.raises(ValueError, match="X has 1 column"):
        FlowMapRegressor(structure=FiveTerms()).fit(valve[0][:, :1], valve[1])


def test_a_finite_p0_draws_to_zero(valve):
    X, Q = valve
    assert np.abs(FlowMapRegressor(p0=1e-12).fit(X, Q).theta_).max() < 0.1
