"""Rest is told from movement, whatever the noise of the position, and in any division."""

import numpy as np
import pytest

from valvemap.model.axis import AxisSamples
from valvemap.model.axis_rest import Rest


def of(x, period_s=0.01):
    return AxisSamples.of(1 + np.arange(len(x)) * round(1e9 * period_s), x=x)


@pytest.mark.parametrize("noise_mm", [0.005, 0.1, 0.5])
@pytest.mark.parametrize("period_s", [0.02, 0.01, 0.001])
def test_a_noisy_position_rests_and_a_creeping_one_moves(noise_mm, period_s):
    t = np.arange(0.0, 60.0, period_s)
    noise = noise_mm * np.random.default_rng(1).standard_normal(len(t))
    _, still = Rest.initial().update(of(400.0 + noise, period_s))
    assert not still[t > 10.0].any()
    _, creeping = Rest.initial().update(of(400.0 + 1.5 * t + noise, period_s))
    assert creeping[t > 10.0].all()


def test_a_turn_and_a_short_rest_belong_to_the_work():
    t = np.arange(0.0, 60.0, 0.01)
    _, turning = Rest.initial().update(of(400.0 + 300.0 * np.sin(t)))
    assert turning.all()
    _, moved = Rest.initial().update(of(np.where(t < 1.0, 300.0 * t, 300.0)))
    assert moved[t < 10.0].all()
    assert not moved[t > 15.0].any()


def test_any_division_gives_the_same_and_a_missing_position_moves():
    x = np.r_[np.linspace(0.0, 500.0, 300), np.full(2_700, 500.0), np.linspace(500.0, 0.0, 300)]
    x[2_900:2_910] = np.nan
    whole, moves = Rest.initial().update(of(x))
    rest, parts, samples = Rest.initial(), [], of(x)
    for start, end in ((0, 1), (1, 1), (1, 2_905), (2_905, len(x))):
        rest, part = rest.update(samples[start:end])
        parts.append(part)
    assert np.concatenate(parts).tolist() == moves.tolist()
    assert rest.memory.tobytes() == whole.memory.tobytes()
    assert moves[2_900:2_910].all()
    assert not moves[2_895]
    assert moves[3_100:].all()


@pytest.mark.parametrize("absurd", [1e308, -1e308, np.inf, 0.0])
def test_absurd_positions_and_times_stop_nothing(absurd):
    x = np.full(300, 400.0)
    x[100:110] = absurd
    t = np.arange(300) * 10_000_000
    t[200], t[201:] = np.iinfo(np.int64).max, t[:99]
    rest, _ = Rest.initial().update(AxisSamples.of(t, x=x))
    _, moves = rest.update(of(np.full(3_000, 400.0)))
    assert moves.any()
