import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from valvemap_rig.faults import VALVE_FAULTS, Fault, FaultKind
from valvemap_rig.scenario import BUILTIN, Scenario, ScenarioError, ValveBench
from valvemap_rig.sensors import Sensor, Sensors
from valvemap_rig.simulation import Commands, advance, initial, is_over
from valvemap_rig.valvistor import Valvistor

EVERYTHING = Scenario(
    seed=7,
    valves=(
        ValveBench(valve=Valvistor(pilot_lag_s=0.03, hysteresis_percent=2)),
        ValveBench(name="Second"),
    ),
    sensors=Sensors(Q=Sensor(noise=0.4, quantum=0.01, lag_s=0.05, offset=0.1)),
    faults=tuple(
        Fault(kind=kind, start_s=0.05 * (k + 1), duration_s=0.3, size=0.7)
        for k, kind in enumerate(VALVE_FAULTS)
    ),
    excitation=BUILTIN["scattered"].excitation,
)


def run(scenario, blocks):
    state, parts = initial(scenario, 1_000), []
    for n in blocks:
        state, block = advance(scenario, state, n)
        parts.append(block)
    return parts


def same(whole, parts):
    assert np.array_equal(whole.t, np.concatenate([part.t for part in parts]))
    for name, valve in whole.valves.items():
        others = [part.valves[name] for part in parts]
        for column in ("t", "U", "p1", "p2", "Q", "T", "U_true", "dp_true", "T_true", "Q_true"):
            cut = np.concatenate([getattr(other, column) for other in others])
            assert getattr(valve, column).tobytes() == cut.tobytes(), (name, column)
        for signal in valve.status:
            status = np.concatenate([other.status[signal] for other in others])
            present = np.concatenate([other.present[signal] for other in others])
            assert np.array_equal(valve.status[signal], status)
            assert np.array_equal(valve.present[signal], present)
    for name, machine in whole.machines.items():
        others = [part.machines[name] for part in parts]
        for column in ("shown", "truth", "status", "present"):
            for signal, values in getattr(machine, column).items():
                cut = np.concatenate([getattr(other, column)[signal] for other in others])
                assert values.tobytes() == cut.tobytes(), (name, column, signal)


@settings(max_examples=15, deadline=None)
@given(st.lists(st.integers(0, 40), min_size=1, max_size=8))
def test_blocks_cut_otherwise_hold_the_same_bits(blocks):
    (whole,) = run(EVERYTHING, [sum(blocks)])
    same(whole, run(EVERYTHING, blocks))


@pytest.mark.parametrize("name", BUILTIN)
def test_every_built_in_scenario_holds_the_same_bits_however_cut(name):
    (whole,) = run(BUILTIN[name], [1500])
    same(whole, run(BUILTIN[name], [1, 0, 499, 1000]))


def test_another_seed_gives_other_noise_and_the_same_truth():
    one, other = Scenario(seed=1), Scenario(seed=2)
    (a,), (b,) = run(one, [500]), run(other, [500])
    assert not np.array_equal(a.valves["Valvistor"].Q, b.valves["Valvistor"].Q)
    assert np.array_equal(a.valves["Valvistor"].Q_true, b.valves["Valvistor"].Q_true)


def test_source_times_are_multiples_of_100_ns_and_never_fall_behind():
    scenario = Scenario(sample_rate_hz=333, time_factor=7)
    (block,) = run(scenario, [10_000])
    assert not (block.t % 100).any()
    expected = 1_000 + np.arange(10_000) * 1e9 / (333 * 7)
    assert np.abs(block.t - expected).max() <= 100


def test_a_time_factor_lets_samples_follow_each_other_faster_and_changes_nothing_else():
    (slow,), (fast,) = run(Scenario(), [300]), run(Scenario(time_factor=100), [300])
    assert np.array_equal(slow.valves["Valvistor"].Q, fast.valves["Valvistor"].Q)
    assert slow.t[-1] - slow.t[0] == 100 * (fast.t[-1] - fast.t[0])


def test_a_scenario_ends_after_its_duration():
    scenario = Scenario(duration_s=1.0)
    state, block = advance(scenario, initial(scenario, 0), 150)
    assert len(block) == 100
    assert is_over(scenario, state)
    _, block = advance(scenario, state, 10)
    assert len(block) == 0


def test_the_sequence_counts_every_sample():
    blocks = run(Scenario(), [3, 4])
    assert np.concatenate([block.sequence for block in blocks]).tolist() == list(range(7))


def test_a_command_moves_the_valve_from_the_next_block_on():
    scenario = BUILTIN["external"]
    state, before = advance(scenario, initial(scenario, 0), 10)
    state, after = advance(scenario, state, 10, Commands(U={"Valvistor": 60.0}))
    _, later = advance(scenario, state, 10)
    assert (before.valves["Valvistor"].U_true == 0).all()
    assert (after.valves["Valvistor"].U_true == 60).all()
    assert (later.valves["Valvistor"].U_true == 60).all()


def test_a_commanded_load_takes_the_place_of_the_sweep_until_it_is_withdrawn():
    scenario, name = BUILTIN["external"], "Valvistor"
    state, dp = initial(scenario, 0), []
    for load in (150.0, 60.0, math.nan):
        state, block = advance(scenario, state, 200, Commands(load={name: load}))
        dp.append(block.valves[name].dp_true[-1])
    p0 = scenario.valves[0].circuit.p0_bar
    assert dp[:2] == pytest.approx([p0 - 150.0, p0 - 60.0], abs=5.0)
    own = run(scenario, [200] * 3)[-1].valves[name].dp_true[-1]
    assert dp[2] == pytest.approx(own, abs=1.0)


def test_a_commanded_fault_starts_with_the_next_block():
    scenario = Scenario()
    state, _ = advance(scenario, initial(scenario, 0), 50)
    fault = Fault(kind=FaultKind.BAD_QUALITY, duration_s=0.2)
    state, block = advance(scenario, state, 50, Commands(faults=(("Valvistor", fault),)))
    status = block.valves["Valvistor"].status["Q"]
    assert (status[:20] == 0x808C0000).all()
    assert (status[20:] == 0).all()
    assert state.valves["Valvistor"].faults == ()


def test_a_fault_of_one_valve_leaves_the_other_alone():
    valves = (ValveBench(), ValveBench(name="Second"))
    fine = Scenario(valves=valves)
    faulty = Scenario(valves=valves, faults=(Fault(kind=FaultKind.OFFSET, size=5, valve="Second"),))
    (a,), (b,) = run(fine, [50]), run(faulty, [50])
    assert np.array_equal(a.valves["Valvistor"].Q, b.valves["Valvistor"].Q)
    assert np.allclose(b.valves["Second"].Q - a.valves["Second"].Q, 5)


@pytest.mark.parametrize(
    ("commands", "sentence"),
    [
        (Commands(U={"Nobody": 1.0}), "Nobody: no such valve; allowed are Valvistor"),
        (Commands(U={"Valvistor": 101.0}), r"U command must be within 0 … 100 %, not 101"),
        (Commands(U={"Valvistor": float("nan")}), "must be within"),
        (Commands(load={"Valvistor": 401.0}), "0 … 400 bar, not 401"),
        (
            Commands(faults=(("Valvistor", Fault(kind=FaultKind.DAMAGE)),) * 201),
            "more than 200 faults",
        ),
    ],
)
def test_a_command_that_cannot_be_obeyed_is_refused(commands, sentence):
    state = initial(Scenario(), 0)
    with pytest.raises(ScenarioError, match=sentence):
        advance(Scenario(), state, 1, commands)
