"""When a run has converged, and the paper's recursions as it prints them."""

import numpy as np
import pytest

from paper import operations, printed
from paper.data import Points, exchanged, within
from paper.evidence import Damage
from paper.learning import UNSETTLED, USELESS, Course, checkpoints, learnt
from valvemap.model.least_squares import batch_least_squares
from valvemap.model.rbf_network import RbfNetwork

AFTER = np.arange(1, 301)


def course(late, early=100.0):
    return Course.of(AFTER, np.where(AFTER <= 50, early, late))


def test_a_run_that_stays_at_a_useful_error_has_converged():
    run = course(2.0)
    assert run.converged
    assert run.unrest == pytest.approx(1 / UNSETTLED)
    assert run.settled_after == 51
    assert run.final == 2.0


def test_a_map_that_is_of_no_use_has_not_converged_however_still_it_is():
    run = course(USELESS * 1.1)
    assert run.unrest == pytest.approx(1.1)
    assert run.settled_after == np.inf


@pytest.mark.parametrize(("share", "converged"), [(0.02, True), (0.2, False)])
def test_a_few_peaks_are_forgiven_many_are_not(share, converged):
    peaks = np.where(np.random.default_rng(0).random(300) < share, 8.0, 2.0)
    assert Course.of(AFTER, peaks).converged is converged


def test_a_run_that_rises_at_its_end_has_not_converged():
    assert not Course.of(AFTER, np.where(AFTER > 280, 9.0, 2.0)).converged


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_blew_up_has_not_converged(value):
    run = course(value)
    assert run.unrest == np.inf
    assert not run.converged


def test_within_counts_from_the_last_time_outside():
    run = Course.of([10, 20, 30, 40], [1.0, 5.0, 1.0, 1.0])
    assert run.within(2.0) == 30
    assert run.within(10.0) == 10
    assert run.within(0.5) == np.inf


@pytest.mark.parametrize("n", [1, 50, 220, 22_000])
def test_checkpoints_ascend_to_the_last_sample(n):
    after = checkpoints(n)
    assert (np.diff(after) > 0).all()
    assert (after[0], after[-1]) == (1, n)


def test_printed_28_is_least_squares_with_lam_squared():
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(200, 3)), rng.normal(size=200)
    theta = printed.least_squares(X, y, 0.97)[-1]
    np.testing.assert_allclose(theta, batch_least_squares(X, y, 0.97**2), rtol=1e-5)


def test_printed_29_finds_a_static_map_where_the_noise_is_white():
    rng = np.random.default_rng(0)
    X = np.stack([np.ones(2000), rng.uniform(0, 100, 2000)], axis=1)
    y = X @ [3.0, 0.5] + 0.1 * rng.normal(size=2000)
    np.testing.assert_allclose(printed.maximum_likelihood_map(X, y)[-1], [3.0, 0.5], rtol=0.05)


def test_the_steps_of_the_network_differ_in_what_is_misprinted_alone():
    settings = RbfNetwork(grid=(2, 2))
    net = printed.start(settings)._replace(w=np.full(4, 0.1))
    x, y = np.array([0.2, 0.7]), 0.5
    right = printed.corrected_step(net, x, y, settings)
    of_37 = printed.step_of_37(net, x, y, settings)
    of_32 = printed.step_of_32(net, x, y, settings)
    np.testing.assert_array_equal(of_37.w, right.w)
    np.testing.assert_array_equal(of_37.b, right.b)
    assert (np.abs(of_37.dc) > np.abs(right.dc)).all()
    error = y - float(printed.output(net, x[None])[0])
    np.testing.assert_allclose(of_32.dw, right.dw * 0.5 / error)


def test_the_damage_is_judged_by_a_fresh_start_after_it(paper_data):
    damage = Damage.of(paper_data.damaged, paper_data.worn)
    assert damage.end(0.99) < 1.1
    assert damage.end(1.0) > 5.0


def test_operations_grow_with_the_square_of_parameters_and_with_neurons():
    five, ten = operations.least_squares_step(5), operations.least_squares_step(10)
    assert five.plain == 125
    assert 3 < ten.plain / five.plain < 4
    small, large = (operations.network_step(RbfNetwork(grid=(m, m))) for m in (5, 10))
    assert (small.exponentials, large.exponentials) == (25, 100)
    assert large.plain == pytest.approx(4 * small.plain, rel=0.01)


def test_a_corner_is_cut_out_and_inputs_are_exchanged(paper_data):
    corner = within(paper_data.scattered, 70.0, 120.0)
    assert corner.U.max() <= 70.0
    assert corner.dp.max() <= 120.0
    swapped = exchanged(corner)
    np.testing.assert_array_equal(swapped.U, corner.Q)
    np.testing.assert_array_equal(swapped.Q, corner.U)
    assert len(Points(corner.U, corner.dp, corner.T, corner.Q)) == len(corner)


def test_more_passes_teach_a_network_more(paper_data):
    network, truth = RbfNetwork(), paper_data.new
    errors = [
        np.std(network.predict(learnt(network, paper_data.scattered, k), *columns(truth))[0])
        for k in (1, 3)
    ]
    assert errors[0] != errors[1]


def columns(points):
    return points.U, points.dp, points.T
