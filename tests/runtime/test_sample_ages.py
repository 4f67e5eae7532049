"""Ages of samples by the clocks of their sources."""

from types import SimpleNamespace

import numpy as np
import pytest

from valvemap.clock import ManualClock
from valvemap.runtime.sample_ages import SampleAges
from valvemap.runtime.sources import Part, Sources

VALVES = 3
S = 10**9


@pytest.fixture
def clock():
    found = ManualClock()
    found.advance(10_000.0)
    return found


@pytest.fixture
def north():
    return SimpleNamespace(clock_offset_s=0.0)


@pytest.fixture
def ages(clock, north):
    south = SimpleNamespace(clock_offset_s=5.0)
    parts = [Part("North", north, (0, 2)), Part("South", south, (1,))]
    found = SampleAges(VALVES, Sources(parts), clock)
    found.note(np.arange(VALVES), clock.now() + np.array([0, 5, 0]) * S)
    return found


def test_an_age_grows_by_the_clock_of_its_own_source(ages, clock):
    assert ages.of() == pytest.approx([0.0, 0.0, 0.0], abs=1e-5)
    clock.advance(2.5)
    assert ages.of() == pytest.approx([2.5, 2.5, 2.5], abs=1e-5)


def test_a_new_reading_of_a_source_s_clock_counts_at_once(ages, clock, north):
    clock.advance(2.5)
    ages.of()
    north.clock_offset_s = 0.75
    assert ages.of() == pytest.approx([3.25, 2.5, 3.25], abs=1e-5)


def test_a_step_of_a_clock_ages_no_sample(ages, clock, north):
    clock.advance(2.5)
    ages.of()
    north.clock_offset_s = 3600.0
    assert ages.of() == pytest.approx([2.5, 2.5, 2.5], abs=1e-5)


def test_a_correction_that_a_new_sample_brings_counts_at_once(ages, clock):
    clock.advance(2.5)
    ages.of()
    ages.note(np.array([0]), np.array([clock.now() - 3600 * S]))  # set back by an hour
    assert ages.of() == pytest.approx([0.0, 2.5, 2.5], abs=1e-5)
    ages.clocks.forget(np.array([0]))
    assert ages.of()[0] == pytest.approx(3600.0, abs=1e-5)
