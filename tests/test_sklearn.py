import numpy as np
import pytest

pytest.importorskip("sklearn")

from sklearn.base import clone
from sklearn.model_selection import cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.estimator_checks import check_estimator, parametrize_with_checks

from valvemap.model.forgetting import Adaptive, Directional
from valvemap.model.least_squares import batch_least_squares
from valvemap.model.model_structures import FiveTerms
from valvemap.model.tensor_spline import TensorSpline
from valvemap.sklearn import EXPECTED_FAILURES, AutoFlowMap, FlowMapRegressor


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


@pytest.mark.filterwarnings("ignore")
def test_auto_fails_the_checks_with_other_columns_and_no_others():
    results = check_estimator(AutoFlowMap(), expected_failed_checks=EXPECTED_FAILURES)
    by_status = {status: set() for status in ("passed", "xfail", "skipped")}
    for result in results:
        by_status[result["status"]].add(result["check_name"])
    assert by_status["xfail"] == set(EXPECTED_FAILURES)
    assert len(by_status["passed"]) > 35
    for result in results:
        if result["status"] == "xfail":
            assert "U, dp or U, dp, T are allowed" in str(result["exception"].__cause__ or result)


@pytest.fixture
def worn():
    """A dead band, and a flow that rises with the temperature."""
    rng = np.random.default_rng(3)
    U, dp, T = (rng.uniform(low, high, 4000) for low, high in ((0, 100), (5, 200), (30, 60)))
    Q = 2.0 * np.clip(U - 8.0, 0.0, 90.0) * np.sqrt(dp / 200) * (1 + 0.004 * (T - 40))
    return np.column_stack([U, dp, T]), Q + 0.2 * rng.normal(size=4000)


def test_auto_chooses_a_structure_that_eq_7_has_not(worn):
    X, Q = worn
    model = AutoFlowMap().fit(X[:3000], Q[:3000])
    assert model.structure_ != "eq. (7)"
    assert model.score(X[3000:], Q[3000:]) > 0.9985
    assert FlowMapRegressor().fit(X[:3000], Q[:3000]).score(X[3000:], Q[3000:]) < 0.998
    Q_hat, std = model.predict(X[3000:], return_std=True)
    assert Q_hat.shape == std.shape == (1000,)
    assert np.median(std) < 0.2


def test_auto_learns_the_same_in_parts_to_the_bit(worn):
    X, Q = worn
    whole, parts = AutoFlowMap().fit(X, Q), AutoFlowMap()
    for i in range(0, len(X), 700):
        parts.partial_fit(X[i : i + 700], Q[i : i + 700])
    np.testing.assert_array_equal(parts.predict(X), whole.predict(X))


@pytest.mark.parametrize("features", [1, 4])
def test_auto_names_the_columns_that_it_takes(features):
    with pytest.raises(ValueError, match=rf"X has {features} feature\(s\); U, dp or U, dp, T"):
        AutoFlowMap().fit(np.ones((9, features)), np.ones(9))


def test_auto_tells_what_it_does_not_learn_beyond_its_ranges(worn):
    X, Q = worn
    with pytest.warns(UserWarning, match=r"rows are not learnt: U is .* U_range = \(0.0, 50.0\)"):
        half = AutoFlowMap(U_range=(0, 50)).fit(X, Q)
    _, std = half.predict([[90.0, 60.0, 40.0], [40.0, 60.0, 40.0]], return_std=True)
    assert np.isnan(std).tolist() == [True, False]
    with pytest.warns(UserWarning, match="without a scaler"):
        make_pipeline(StandardScaler(), AutoFlowMap()).fit(X, Q)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"U_range": (100, 0)}, r"U_range is \(100, 0\); a low and a high end are allowed"),
        ({"U_range": "ab"}, "U_range is 'ab'"),
        ({"dp_range": (0, np.inf)}, "dp_range is"),
        ({"interval": 0}, "interval is 0; a number of seconds above 0"),
    ],
)
def test_auto_names_a_wrong_parameter(worn, arguments, said):
    with pytest.raises(ValueError, match=said):
        AutoFlowMap(**arguments).fit(*worn)


def test_auto_takes_its_ranges_as_lists(worn):
    given = AutoFlowMap(U_range=[0, 100], dp_range=[0, 200]).fit(*worn)
    np.testing.assert_array_equal(given.predict(worn[0]), AutoFlowMap().fit(*worn).predict(worn[0]))
