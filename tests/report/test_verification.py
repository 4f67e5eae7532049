import io
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from service.report.verification import Score, Tally, score, verification_table

flows = st.lists(
    st.tuples(st.floats(-1e3, 1e3) | st.just(math.nan), st.floats(-1e3, 1e3) | st.just(math.inf)),
    max_size=50,
)


def test_a_score_computed_by_hand():
    figures = score(np.array([0.0, 10.0, 20.0]), np.array([0.0, 13.0, 16.0]))
    assert figures.rmse == pytest.approx(math.sqrt(25 / 3))
    assert figures.nrmse == pytest.approx(math.sqrt(25 / 3) / 20)
    assert figures.max_abs == 4
    assert figures.r2 == pytest.approx(1 - 25 / 200)
    assert figures.n == 3


def test_a_perfect_prediction_scores_one():
    Q = np.linspace(-5, 200, 100)
    assert score(Q, Q) == Score(0.0, 0.0, 0.0, 1.0, 100)


def test_the_mean_as_prediction_explains_nothing():
    Q = np.array([1.0, 2.0, 6.0])
    assert score(Q, np.full(3, 3.0)).r2 == pytest.approx(0)


def test_samples_that_are_not_finite_do_not_count():
    Q = np.array([1.0, np.nan, 3.0, 4.0])
    assert score(Q, np.array([1.0, 2.0, np.inf, 4.0])) == score(Q[[0, 3]], Q[[0, 3]])


@pytest.mark.parametrize("n", [0, 3])
def test_without_any_sample_nothing_is_defined(n):
    figures = score(np.full(n, np.nan), np.zeros(n))
    assert figures.n == 0
    assert math.isnan(figures.rmse)


def test_a_constant_flow_has_an_error_but_no_range():
    figures = score(np.full(4, 7.0), np.full(4, 8.0))
    assert figures.rmse == 1
    assert math.isnan(figures.nrmse)
    assert math.isnan(figures.r2)


def test_a_small_variation_on_a_large_flow_keeps_its_digits():
    Q = 1e8 + np.array([0.0, 1.0, 2.0, 3.0])
    assert score(Q, Q + 1).r2 == pytest.approx(1 - 4 / 5)


def test_numbers_at_the_end_of_their_range_raise_nothing():
    figures = score(np.array([1e308, -1e308]), np.array([-1e308, 1e308]))
    assert figures.n == 0


@given(flows, st.integers(1, 7))
def test_a_stream_in_pieces_scores_the_same_bits(pairs, size):
    Q, Q_hat = np.array(pairs, np.float64).reshape(-1, 2).T
    tally = Tally()
    for start in range(0, len(Q), size):
        tally = tally.add(Q[start : start + size], Q_hat[start : start + size])
    assert tally == Tally().add(Q, Q_hat)


def test_the_table_shows_every_estimator_of_every_valve():
    figures = Score(rmse=1.23456, nrmse=0.00612, max_abs=7.5, r2=0.998765, n=12_345)
    nothing = Score(math.nan, math.nan, math.nan, math.nan, 0)
    console = Console(file=io.StringIO(), width=100)
    console.print(
        verification_table("Against truth", {"V1": {"RLS": figures, "RBF": nothing}, "V2": {}})
    )
    text = console.file.getvalue()
    for part in ("Against truth", "V1", "RLS", "1.235", "0.612", "7.5", "0.99877", "12,345", "RBF"):
        assert part in text
    assert "nan" not in text
