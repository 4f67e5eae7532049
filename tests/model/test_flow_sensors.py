"""Sensors at fault: offsets of the meter and of Δp are causes, and the map stays the valve's."""

import pytest

from benchmarks.drawn_plants import drawn
from benchmarks.one_model import measured
from benchmarks.one_model_sensors import offset
from benchmarks.unseen_plants import judged
from valvemap.model.flow_map import FlowMap
from valvemap.vocabulary.findings import FindingCode

ZERO, PRESSURE = FindingCode.FLOW_ZERO, FindingCode.PRESSURE_ZERO


@pytest.mark.parametrize(
    ("seed", "of_Q", "of_dp", "codes"),
    [
        (41, 3.0, 0.0, {ZERO}),
        (44, 3.0, 0.0, {ZERO}),  # hardly any flow at first
        (41, 0.0, 2.0, {PRESSURE}),
        (41, 2.0, -6.0, {ZERO, PRESSURE}),
    ],
)
def test_an_offset_of_a_sensor_has_its_name_and_is_not_in_the_map(seed, of_Q, of_dp, codes):
    row = offset("ordinary", seed, 16_000, "drifts", of_Q, of_dp, causes=codes)
    figures = measured(FlowMap(), row)
    assert figures["named"][0] == 1.0
    assert figures["misnamed"][0] == 0.0
    assert figures["rmse"][0] < 0.8
    assert figures["held"][0] > 0.7


def test_what_the_meter_shows_is_predicted_with_its_offset():
    row = offset("ordinary", 42, 14_000, of_Q=1.0)
    flow_map = FlowMap()
    _, trace = flow_map.update(flow_map.initial_state(), row.samples)
    assert abs(trace.residual[-2_000:].mean()) < 0.1


def test_no_offset_moves_where_a_valve_that_is_shut_has_any_pressure_drop():
    """The map is not known there but for its mean, and no flow runs against Δp."""
    row, words = drawn(10037)
    assert words.startswith("10037 poppet, hammering")
    figures = judged(row)[-1]
    assert figures["found"] == set()
    assert figures["rmse"] < 0.5
    assert figures["held"] > 0.9


def test_a_sensor_that_jumps_on_one_side_of_no_opening_is_expected_on_the_other():
    """Each side has filters of its own, but there is one meter."""
    row, words = drawn(17022)
    assert words.startswith("17022 servo, moulding, 5 Hz")
    figures = judged(row)[-1]
    assert figures["found"] == {ZERO}
    assert figures["rmse"] < 0.5
    assert figures["held"] > 0.9
    assert figures["wrong"] == 0.0
