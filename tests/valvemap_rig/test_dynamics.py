import numpy as np
import pytest

from valvemap_rig.dynamics import lag, play, second_order

NONE = float("nan")


def test_a_loop_is_as_wide_as_its_hysteresis():
    u = np.concatenate([np.linspace(0, 100, 1001), np.linspace(100, 0, 1001)])
    y = play(u, 4.0, NONE)
    up, down = np.interp(50, u[:1001], y[:1001]), np.interp(50, u[:1000:-1], y[:1000:-1])
    assert down - up == pytest.approx(4.0)


def test_without_hysteresis_the_signal_passes_unchanged():
    u = np.random.default_rng(0).uniform(0, 100, 200)
    assert np.array_equal(play(u, 0.0, NONE), u)


def test_moves_inside_the_loop_move_nothing():
    assert play(np.array([50.0, 50.5, 49.6, 50.2]), 2.0, NONE).tolist() == [50.0] * 4


def test_the_first_sample_finds_hysteresis_and_lag_at_rest():
    assert play(np.array([7.0]), 3.0, NONE)[0] == 7
    assert lag(np.array([7.0]), 3.0, 0.01, NONE)[0] == 7


@pytest.mark.parametrize("cut", [0, 1, 137, 300])
def test_both_go_on_over_the_cut_between_blocks(cut):
    u = np.random.default_rng(1).normal(size=300)
    for whole, parts in (
        (play(u, 1.0, 0.0), lambda part, memory: play(part, 1.0, memory)),
        (lag(u, 0.1, 0.01, 0.0), lambda part, memory: lag(part, 0.1, 0.01, memory)),
    ):
        first = parts(u[:cut], 0.0)
        second = parts(u[cut:], first[-1] if cut else 0.0)
        assert np.concatenate([first, second]).tobytes() == whole.tobytes()


def spool(u, memory=(NONE, 0.0), hz=8.0):
    return second_order(u, np.full(len(u), hz), 0.6, 0.01, memory)


def test_a_spool_follows_a_step_as_the_formula_says():
    u = np.concatenate([[0.0], np.full(60, 100.0)])
    x, _ = spool(u)
    t = 0.01 * np.arange(60)
    w, damped = 2 * np.pi * 8.0, 2 * np.pi * 8.0 * 0.8
    truth = 1 - np.exp(-0.6 * w * t) * (np.cos(damped * t) + 0.75 * np.sin(damped * t))
    assert x[1:] == pytest.approx(100.0 * truth, abs=0.05)


@pytest.mark.parametrize("cut", [1, 137, 299])
def test_a_spool_goes_on_over_the_cut_between_blocks(cut):
    u = np.random.default_rng(1).uniform(0.0, 100.0, 300)
    whole, _ = spool(u)
    first, memory = spool(u[:cut])
    second, _ = spool(u[cut:], memory)
    assert np.concatenate([first, second]).tobytes() == whole.tobytes()
