import numpy as np
import pytest

from valvemap_rig.dynamics import lag, play

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
