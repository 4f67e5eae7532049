"""Ages continue over the steps of a clock, also while samples are late."""

import numpy as np
import pytest

from valvemap.pipeline.sample_clocks import SampleClocks

HOUR_S = 3_600.0
ONE = np.array([0])


def age_s(clocks, now_s, offset_s, taken_s, ahead_s):
    """The age of a sample that arrives now."""
    t = round((taken_s + ahead_s) * 1e9)
    clocks.note(ONE, np.array([t]), now_s, np.array([offset_s]))
    return now_s + offset_s + clocks.correction_s[0] - t * 1e-9


@pytest.mark.parametrize("late_s", [0.0, 3.0, 10.0, 60.0])
def test_the_age_of_a_backlog_continues_over_a_clock_that_was_set_back(late_s):
    """The source's clock is read at once, its samples of before the step arrive late."""
    clocks = SampleClocks(1)
    assert age_s(clocks, 1.0, 0.0, 1.0, 0.0) == pytest.approx(0.0)
    before = age_s(clocks, 100.0, -HOUR_S, 100.0 - late_s, 0.0)
    assert before == pytest.approx(late_s)
    for now_s in (104.0, 105.0, 107.0):
        after = age_s(clocks, now_s, -HOUR_S, now_s - late_s - 0.5, -HOUR_S)
        assert after == pytest.approx(late_s + 0.5)


def test_a_sample_is_not_later_than_the_one_before_it_and_the_silence_since():
    """Samples alone are set back: the clock is read later, and the age is continued meanwhile."""
    clocks = SampleClocks(1)
    age_s(clocks, 1.0, 0.0, 1.0, 0.0)
    assert age_s(clocks, 2.0, 0.0, 2.0, -HOUR_S) < 3.0
    assert age_s(clocks, 3.0, -HOUR_S, 3.0, -HOUR_S) == pytest.approx(0.0)
