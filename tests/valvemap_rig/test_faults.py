import numpy as np
import pytest

from valvemap_rig.fault_effects import (
    BAD_SENSOR_FAILURE,
    UNCERTAIN_SENSOR_NOT_ACCURATE,
    ActiveFault,
    clock_error_ns,
    edge_factor,
    sensor_faults,
    still_felt,
    temperature_rise,
    worn_gap,
)
from valvemap_rig.faults import SIGNALS, VALVE_FAULTS, Fault, FaultError, commanded_fault

RATE, N = 100.0, 1000
INDEX = np.arange(N)


def active(kind, start=200, **values):
    return (ActiveFault(Fault(kind=kind, **values), start),)


def felt(faults, signal="Q"):
    return sensor_faults(faults, signal, INDEX, RATE, 1, "Valvistor")


def test_without_faults_everything_is_fine():
    fine = felt(())
    assert not fine.added.any()
    assert not fine.frozen.any()
    assert not fine.status.any()
    assert fine.present.all()
    assert (edge_factor((), INDEX, RATE) == 1).all()


def test_wear_drifts_to_its_size_and_stays():
    edge = edge_factor(active("wear", size=10, duration_s=5), INDEX, RATE)
    assert (edge[:200] == 1).all()
    assert edge[449] == pytest.approx(1.05)
    assert (edge[699:] == 1.1).all()
    assert (np.diff(edge) >= 0).all()


def test_damage_is_abrupt_and_for_good_unless_it_has_a_duration():
    for_good = edge_factor(active("damage", size=-10), INDEX, RATE)
    assert (for_good[:200] == 1).all()
    assert (for_good[200:] == 0.9).all()
    repaired = edge_factor(active("damage", size=-10, duration_s=1), INDEX, RATE)
    assert (repaired == 0.9).sum() == 100


def test_wear_and_damage_add_up_but_leave_something_of_the_edge():
    both = active("wear", size=10, start=0) + active("damage", size=-10, start=0)
    assert edge_factor(both, INDEX, RATE)[-1] == pytest.approx(0.99)
    assert edge_factor(active("damage", size=-90) * 50, INDEX, RATE)[-1] == 0.01


def test_the_tank_warms_along_a_ramp_and_stays_warm():
    rise = temperature_rise(active("temperature_ramp", size=15, duration_s=3), INDEX, RATE)
    assert (rise[:200] == 0).all()
    assert rise[349] == pytest.approx(7.5)
    assert (rise[499:] == 15).all()


def test_a_sensor_freezes_for_the_duration():
    frozen = felt(active("frozen", duration_s=2)).frozen
    assert frozen[200:400].all()
    assert frozen.sum() == 200


def test_spikes_hit_two_percent_of_the_samples_in_both_directions():
    added = sensor_faults(
        active("spikes", start=0, size=30), "Q", np.arange(50_000), RATE, 1, "V"
    ).added
    assert set(np.unique(added)) == {-30.0, 0.0, 30.0}
    assert 0.017 < np.mean(added != 0) < 0.023


def test_an_offset_is_added():
    added = felt(active("offset", size=4, duration_s=1)).added
    assert (added[200:300] == 4).all()
    assert np.count_nonzero(added) == 100


@pytest.mark.parametrize(
    ("kind", "code"),
    [("bad_quality", BAD_SENSOR_FAILURE), ("uncertain_quality", UNCERTAIN_SENSOR_NOT_ACCURATE)],
)
def test_a_status_is_worse_for_the_given_share_of_samples(kind, code):
    whole = felt(active(kind, duration_s=3)).status
    assert (whole[200:500] == code).all()
    assert np.count_nonzero(whole) == 300
    half = felt(active(kind, start=0, size=0.5)).status
    assert 400 < np.count_nonzero(half) < 600


def test_bad_is_worse_than_uncertain():
    both = active("bad_quality") + active("uncertain_quality")
    assert (felt(both).status[200:] == BAD_SENSOR_FAILURE).all()


def test_a_dropped_sample_drops_out_as_a_whole():
    faults = active("drop_out", size=0.3)
    present = [felt(faults, signal).present for signal in SIGNALS]
    assert 0.6 < present[0][200:].mean() < 0.8
    for other in present[1:]:
        assert np.array_equal(present[0], other)


def test_one_signal_can_drop_out_alone():
    faults = active("drop_out", signal="p2")
    assert not felt(faults, "p2").present[200:].any()
    assert felt(faults, "Q").present.all()


def test_the_clock_steps_and_steps_back():
    error = clock_error_ns(active("clock_step", size=-0.5, duration_s=1), INDEX, RATE)
    assert (error[200:300] == -500_000_000).all()
    assert np.count_nonzero(error) == 100


def test_only_what_is_over_is_forgotten():
    faults = (
        *active("offset", duration_s=1),
        *active("offset"),
        *active("wear", duration_s=1),
        *active("damage", duration_s=1),
    )
    assert still_felt(faults, 299, RATE) == faults
    kinds = [one.fault.kind for one in still_felt(faults, 300, RATE)]
    assert kinds == ["offset", "wear"]


def test_a_faults_own_signal_is_q_if_none_is_named():
    assert Fault(kind="frozen").signals == ("Q",)
    assert Fault(kind="drop_out").signals == SIGNALS
    assert Fault(kind="damage").signals == ()


@pytest.mark.parametrize("kind", VALVE_FAULTS)
def test_every_kind_can_be_commanded(kind):
    assert commanded_fault(str(kind), 0.5, 2.0).kind is kind


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("rust", 1.0, 0.0), "kind 'rust': allowed are wear, damage"),
        (("frozen.x", 1.0, 0.0), "kind 'frozen.x': allowed"),
        (("damage.Q", 1.0, 0.0), "damage is not of a sensor"),
        (("damage", 500.0, 0.0), "size of damage must be within -90 … 100"),
        (("drop_out", 2.0, 0.0), "size of drop_out must be within 0 … 1"),
        (("offset", float("nan"), 0.0), "size: .*finite"),
        (("offset", 1.0, -1.0), "duration_s: .*greater than or equal to 0"),
        (("offset", 1.0, float("inf")), "duration_s: .*finite"),
    ],
)
def test_a_command_that_makes_no_sense_is_told_so_in_one_line(arguments, sentence):
    with pytest.raises(FaultError, match=sentence) as caught:
        commanded_fault(*arguments)
    assert "\n" not in str(caught.value)


def test_a_worn_gap_is_there_for_its_duration_and_gaps_add_up():
    gap = worn_gap(active("edge", size=0.3) + active("edge", size=0.2, duration_s=1), INDEX, RATE)
    assert (gap[:200] == 0).all()
    assert (gap[200:300] == 0.5).all()
    assert (gap[300:] == 0.3).all()


def test_a_signal_lags_more_for_the_duration_and_others_do_not():
    faults = active("lag", size=0.2, duration_s=1)
    assert (felt(faults).lag_s[200:300] == 0.2).all()
    assert np.count_nonzero(felt(faults).lag_s) == 100
    assert not felt(faults, "p1").lag_s.any()
    assert felt(active("lag", size=0.2, signal="p1"), "p1").lag_s.any()
