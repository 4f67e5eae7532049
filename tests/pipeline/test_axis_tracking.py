"""The tracking error of an axis: of the newest seconds, bounded, and of whole samples alone."""

import dataclasses

import numpy as np
import pytest

from valvemap.model.axis import AxisGeometry
from valvemap.model.samples import Samples
from valvemap.pipeline.axes import Axis
from valvemap.pipeline.axis_plan import AxisPlan
from valvemap.pipeline.axis_tracking import SPAN_S, STEP_S, Tracking


def moments(seconds):
    return np.arange(1, round(100 * seconds) + 1) * 10_000_000


def test_the_error_is_that_of_the_newest_seconds_and_the_course_is_bounded():
    tracking, t = Tracking(), moments(100)
    x = np.where(t < 70_000_000_000, 5.0, 1.0)
    for start in range(0, len(t), 7):
        part = slice(start, start + 7)
        tracking.take(t[part], x[part], np.zeros(len(t[part])))
    assert tracking.course.rms == pytest.approx(1.0)
    assert len(tracking.course.t) <= SPAN_S / STEP_S + 1
    assert tracking.course.t[-1] - tracking.course.t[0] <= 1e9 * SPAN_S


def test_it_is_renewed_once_a_second_and_missing_values_are_left_out():
    tracking, t = Tracking(), moments(3)
    x = np.full(len(t), 2.0)
    x[50:60] = np.nan
    courses = []
    for k in range(len(t)):
        tracking.take(t[k : k + 1], x[k : k + 1], np.zeros(1))
        courses.append(tracking.course)
    assert len({id(course) for course in courses}) == 3
    assert courses[-1].rms == 2.0


def test_an_axis_takes_its_set_position_from_line_b():
    plan = AxisPlan("Press", AxisGeometry(63, 45, 800, 1.2, 1.2), is_tracked=True)
    one, t = Axis(plan), moments(2)
    n = np.ones(len(t))
    for line, other in enumerate((40.0, 396.0)):
        one.take_line(
            line,
            Samples(
                t=t, U=20 * n, p1=90 * n, p2=60 * n, Q=400 * n, T=other * n,
                quality=np.zeros(len(t), np.uint8),
            ),
        )  # fmt: skip
    assert one.results().tracking.rms == 4.0
    assert one.results().tracking.set_position[0] == 396.0
    assert one.key == Axis(dataclasses.replace(plan, is_tracked=False)).key
