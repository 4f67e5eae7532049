"""A demand that is asked for as much ahead as the spool lags."""

import math

import numpy as np
import pytest

from valvemap.model.lead import DemandCourse, led, spool_delay

H = 0.01  # s; of the demands


def ns(t_s):
    return round(1e9 * t_s)


def advances(demands, lead_s, h=H):
    """The advance at each of the demands, which come every ``h`` seconds."""
    course, found = DemandCourse(), []
    for k, demand in enumerate(demands):
        course = course.after(ns(h * k), demand)
        found.append(course.advance(ns(h * k), lead_s))
    return np.array(found)


def followed(u, f, zeta, dead_s=0.0, h=H, parts=40):
    """The spool behind a signal (N,) that is a line from value to value, each ``h`` seconds."""
    x = v = 0.0
    late, places = [0.0] * round(dead_s / h * parts), []
    w, dt = 2.0 * math.pi * f, h / parts
    for now in np.interp(np.arange(len(u) * parts) / parts, np.arange(len(u)), u):
        late.append(now)
        v += dt * (w * w * (late.pop(0) - x) - 2.0 * zeta * w * v)
        x += dt * v
        places.append(x)
    return np.array(places)[::parts]


def moving(n=1_000, period_s=2.0):
    t = H * np.arange(n)
    return 40.0 * np.sin(2.0 * np.pi * t / period_s) + 15.0 * np.sin(5.3 * t)


def test_a_ramp_is_advanced_by_its_slope_times_the_delay():
    ramp = 100.0 * H * np.arange(20)
    assert advances(ramp, 0.03)[-1] == pytest.approx(3.0)
    assert advances(ramp, 0.0)[-1] == 0.0
    assert advances(ramp[:3], 0.03)[-1] == 0.0  # three values tell no noise


def test_the_delay_is_that_of_slow_sines():
    f, zeta, dead_s = 12.0, 0.6, 0.004
    slow_hz = 0.05
    ratio = slow_hz / f
    phase = math.atan2(2.0 * zeta * ratio, 1.0 - ratio**2) + 2.0 * math.pi * slow_hz * dead_s
    expected = phase / (2.0 * math.pi * slow_hz)
    assert spool_delay(f, zeta, dead_s) == pytest.approx(expected, rel=1e-4)
    assert spool_delay(math.inf, 0.8) == 0.0
    assert spool_delay(0.1, 0.8) <= 0.25


@pytest.mark.parametrize("f", [8.0, 14.0, 25.0])
@pytest.mark.parametrize(("zeta", "dead_s"), [(0.5, 0.0), (0.8, 0.0), (1.0, 0.01)])
def test_a_spool_follows_a_led_demand_several_times_as_well(f, zeta, dead_s):
    wanted = moving()
    asked = wanted + advances(wanted, spool_delay(f, zeta, dead_s))
    left = [followed(u, f, zeta, dead_s) - wanted for u in (wanted, asked)]
    without, lead = (float(np.sqrt(np.mean(one[100:] ** 2))) for one in left)
    assert lead < 0.35 * without


@pytest.mark.parametrize("lead_s", [0.01, 0.03, 0.06])
def test_noise_of_a_demand_hardly_shakes_the_led_one_more(lead_s):
    noise = np.random.default_rng(3).normal(0.0, 1.0, 5_000)
    shaken = noise + advances(noise, lead_s)
    assert np.std(shaken) < 1.1 * np.std(noise)
    assert np.std(np.diff(shaken)) < 1.1 * np.std(np.diff(noise))
    assert abs(np.mean(shaken)) < 0.05


def test_a_noisy_course_is_still_led():
    wanted = moving(2_000)
    noisy = wanted + np.random.default_rng(4).normal(0.0, 0.5, len(wanted))
    asked = noisy + advances(noisy, 0.04)
    truth = np.interp(H * np.arange(len(wanted)) + 0.04, H * np.arange(len(wanted)), wanted)
    assert np.std((asked - truth)[50:-50]) < 0.5 * np.std((noisy - truth)[50:-50])


def test_a_step_is_kicked_by_less_than_its_own_size():
    step = np.where(np.arange(60) < 30, 0.0, 10.0)
    for lead_s in (0.01, 0.02, 0.04, 0.1):
        found = advances(step, lead_s)
        assert found.min() > -1e-9
        assert found.max() < 10.0
        assert found[-1] == pytest.approx(0.0)


def test_demands_at_uneven_times_are_led_by_the_same_slope():
    rng, course = np.random.default_rng(5), DemandCourse()
    t = np.cumsum(rng.uniform(0.004, 0.02, 50))
    for now in t:
        course = course.after(ns(now), 50.0 * float(now))
    assert course.advance(ns(t[-1]), 0.03) == pytest.approx(1.5)


def test_a_demand_that_is_left_standing_has_no_lead():
    course = DemandCourse()
    for k in range(20):
        course = course.after(ns(H * k), 2.0 * k)
    last = 19 * H
    assert course.advance(ns(last + H), 0.03) == pytest.approx(6.0)  # no later than usual
    assert course.advance(ns(last + 2.5 * H), 0.03) < 6.0
    assert course.advance(ns(last + 0.4), 0.03) == 0.0


def test_a_demand_written_seldom_is_a_stair_and_no_ramp():
    assert np.all(advances(np.arange(20.0), 0.03, h=0.2) == 0.0)


def test_no_number_a_withdrawn_demand_or_a_clock_set_back_begins_anew():
    course = DemandCourse()
    for k in range(20):
        course = course.after(ns(H * k), 2.0 * k)
    assert course.after(ns(0.3), math.nan) == DemandCourse()
    assert course.after(ns(0.1), 5.0) == DemandCourse((ns(0.1),), (5.0,))
    assert course.after(ns(H * 19), 7.0).values[-1] == 7.0
    assert len(course.after(ns(H * 19), 7.0).t) == 20


def test_the_memory_is_bounded():
    course = DemandCourse()
    for k in range(1_000):
        course = course.after(ns(H * k), float(k))
    assert len(course.t) == len(course.values) == 256


def test_a_lead_beyond_good_answers_is_shortened_down_to_none():
    def within(most):
        return led(lambda x: x, 10.0, 8.0, lambda found: found <= most)

    assert [within(most) for most in (20.0, 15.0, 12.5, 11.0)] == [18.0, 14.0, 12.0, 10.0]
