import numpy as np
import pytest

from valvemap.model.least_squares import batch_least_squares


def test_weights_are_lam_to_the_age_of_the_sample():
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(50, 3)), rng.normal(size=50)
    w = 0.9 ** np.arange(49, -1, -1.0)
    expected = np.linalg.solve((X.T * w) @ X, (X.T * w) @ y)
    np.testing.assert_allclose(batch_least_squares(X, y, 0.9), expected, rtol=1e-10)


def test_columns_of_very_different_size_are_no_trouble():
    rng = np.random.default_rng(1)
    X = rng.normal(size=(100, 3)) * [1e-12, 1.0, 1e12]
    theta = np.array([1e12, 2.0, 3e-12])
    np.testing.assert_allclose(batch_least_squares(X, X @ theta), theta, rtol=1e-12)


def test_samples_that_are_not_finite_are_left_out():
    X = [[1.0, 0.0], [1.0, 1.0], [1.0, np.nan], [1.0, 2.0], [1.0, 9.0]]
    np.testing.assert_allclose(batch_least_squares(X, [1, 3, 8, 5, np.inf]), [1, 2])


def test_what_the_samples_do_not_determine_is_said():
    with pytest.raises(ValueError, match="1 usable samples do not determine 2"):
        batch_least_squares([[1.0, 2.0]], [1.0])
    with pytest.raises(ValueError, match="linearly dependent"):
        batch_least_squares([[1.0, 2.0], [2.0, 4.0], [3.0, 6.0]], [1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match="do not fit"):
        batch_least_squares([[1.0, 2.0]], [1.0, 2.0])
    with pytest.raises(ValueError, match=r"lam = 0\.0"):
        batch_least_squares([[1.0]], [1.0], 0.0)
