"""The truth that maps are compared with is that of the valve as it has become, whatever failed."""

import numpy as np
import pytest

from valvemap_rig.circuit import true_flow
from valvemap_rig.condition import AS_NEW, Condition, condition
from valvemap_rig.fault_effects import ActiveFault
from valvemap_rig.fault_words import fault_effect
from valvemap_rig.faults import UNITS, VALVE_FAULTS, Fault, FaultError, FaultKind, commanded_fault
from valvemap_rig.scenario import BUILTIN, Scenario, ValveBench
from valvemap_rig.sensors import Sensors
from valvemap_rig.simulation import Commands, advance, initial
from valvemap_rig.verification import verification_points

SIZES = {
    FaultKind.WEAR: -20.0,
    FaultKind.DAMAGE: 12.0,
    FaultKind.EDGE: 0.5,
    FaultKind.SLUGGISH: -50.0,
    FaultKind.LAG: 1.0,
    FaultKind.TEMPERATURE_RAMP: 15.0,
    FaultKind.FROZEN: 0.0,
    FaultKind.SPIKES: 30.0,
    FaultKind.OFFSET: 5.0,
    FaultKind.BAD_QUALITY: 0.5,
    FaultKind.UNCERTAIN_QUALITY: 0.5,
    FaultKind.DROP_OUT: 0.5,
    FaultKind.CLOCK_STEP: 2.0,
}
OF_THE_VALVE = {FaultKind.WEAR, FaultKind.DAMAGE, FaultKind.EDGE, FaultKind.TEMPERATURE_RAMP}
RATE = 100.0
BENCH = ValveBench()


def injured(kind, duration_s=0.0, samples=300):
    """A rig that has played with a fault: its state, and its last samples."""
    scenario = BUILTIN["demo"]
    state, _ = advance(scenario, initial(scenario, 0), 50)
    fault = commanded_fault(kind, SIZES[kind], duration_s)
    return advance(scenario, state, samples, Commands(faults=(("Valvistor", fault),)))


def now(state):
    return condition(state.valves["Valvistor"].faults, state.index - 1, RATE)


def test_every_kind_is_tried():
    assert set(SIZES) == set(VALVE_FAULTS)


@pytest.mark.parametrize("kind", VALVE_FAULTS)
def test_the_truth_is_what_the_meter_counts_without_noise(kind):
    state, block = injured(kind)
    valve, worn = block.valves["Valvistor"], now(state)
    late = slice(200, None)
    found = true_flow(BENCH, valve.U_true[late], valve.dp_true[late], valve.T_true[late], worn)
    off = np.abs(found - valve.Q_true[late])  # hysteresis and pilot are no part of the map
    assert np.median(off) < 1.0
    assert (worn != AS_NEW) == (kind in OF_THE_VALVE)


@pytest.mark.parametrize("kind", sorted(OF_THE_VALVE - {FaultKind.TEMPERATURE_RAMP}))
def test_against_the_new_valve_the_same_would_be_far_off(kind):
    _, block = injured(kind)
    valve = block.valves["Valvistor"]
    new = true_flow(BENCH, valve.U_true, valve.dp_true, valve.T_true)
    assert np.median(np.abs(new - valve.Q_true)[200:]) > 2.0


def test_the_oil_of_the_points_is_as_warm_as_the_rigs():
    state, block = injured(FaultKind.TEMPERATURE_RAMP)
    points = verification_points(BUILTIN["demo"], worn=now(state))
    assert pytest.approx(block.valves["Valvistor"].T_true[-1], abs=0.5) == points.T


def test_what_is_repaired_is_as_new():
    state, _ = injured(FaultKind.DAMAGE, duration_s=1.0)
    assert now(state) == AS_NEW


def test_damage_and_wear_multiply_and_gaps_add_up():
    faults = tuple(
        ActiveFault(Fault(kind=kind, size=size), 0)
        for kind, size in (("wear", 10), ("damage", -10), ("edge", 0.2), ("edge", 0.3))
    )
    assert condition(faults, 5, RATE) == pytest.approx(Condition(0.99, 0.5, 0.0))


@pytest.mark.parametrize("kind", VALVE_FAULTS)
def test_every_fault_says_what_it_does_and_for_how_long(kind):
    said = fault_effect(commanded_fault(kind, SIZES[kind], 7.0), BENCH, Sensors())
    assert "7 s" in said
    assert said.isprintable()
    for_good = fault_effect(commanded_fault(kind, SIZES[kind], 0.0), BENCH, Sensors())
    assert for_good.endswith("for good")


def test_a_size_that_noise_hides_is_said_to_be_so():
    hidden = fault_effect(commanded_fault("damage", 0.1, 0.0), BENCH, Sensors())
    assert hidden.startswith("the main edge passes 0.1 % more")
    assert "within the flow meter's noise of 0.4 l/min" in hidden
    seen = fault_effect(commanded_fault("damage", 12.0, 0.0), BENCH, Sensors())
    assert "noise" not in seen
    assert "within its noise of 0.05 bar" in fault_effect(
        commanded_fault("offset.p1", -0.01, 0.0), BENCH, Sensors()
    )


@pytest.mark.parametrize("kind", VALVE_FAULTS)
def test_a_size_that_does_nothing_is_refused_with_its_unit(kind):
    if not UNITS[kind]:
        assert commanded_fault(kind, 0.0, 0.0).size == 0.0
        return
    with pytest.raises(FaultError, match=f"size of {kind} is 0 .*nothing would happen"):
        commanded_fault(kind, 0.0, 0.0)


def test_a_size_beyond_what_is_allowed_is_refused_with_its_unit():
    with pytest.raises(FaultError, match="within -90 … 100 % of the main edge's flow"):
        commanded_fault("damage", 500.0, 0.0)


def test_a_scenarios_own_faults_are_in_its_truth():
    faults = (Fault(kind=FaultKind.DAMAGE, start_s=1, size=-30),)
    scenario = Scenario(faults=faults)
    state, _ = advance(scenario, initial(scenario, 0), 99)
    assert condition(state.valves["Valvistor"].faults, state.index, RATE) == AS_NEW
    state, _ = advance(scenario, state, 10)
    assert condition(state.valves["Valvistor"].faults, state.index, RATE).edge_factor == 0.7
