"""Short forms of the benchmarks over TCP: whatever the machine does beside, nothing is lost."""

import pytest

from benchmarks import latency, live_speed, results_speed


@pytest.mark.alone
def test_a_fleet_is_identified_live_without_a_loss():
    figures = live_speed.measured(valves=60, hz=100.0, seconds=2.0, settling_s=1.0)
    assert figures["lost"] == 0
    assert figures["reached, notifications/s"] > 0.8 * figures["wanted, notifications/s"]


@pytest.mark.waits
def test_a_fleet_is_identified_live_over_encrypted_channels_without_a_loss():
    figures = live_speed.measured(valves=60, hz=50.0, seconds=2.0, settling_s=1.0, secured=True)
    assert figures["lost"] == 0


@pytest.mark.alone
def test_results_of_a_fleet_reach_a_client_without_a_loss():
    figures = results_speed.measured(valves=100, hz=20.0, seconds=2.0, warm_s=1.0)
    assert figures["lost"] == 0
    assert figures["notifications/s"] > 0.8 * 100 * 20 * 5


@pytest.mark.alone
def test_a_thousand_samples_a_second_of_one_valve_reach_a_client_without_a_loss():
    figures = latency.measured(hz=1_000.0, seconds=1.0, known=False, clients=("ours",))
    assert figures["lost"] == 0
    assert figures["ours: p50, ms"] < 250.0
