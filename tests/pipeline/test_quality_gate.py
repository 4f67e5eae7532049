import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from valvemap.model.samples import Samples
from valvemap.pipeline.quality_gate import QualityGate, SignalLimits
from valvemap.vocabulary.signals import SENSORS, Signal
from valvemap.vocabulary.statuses import Quality

GOOD, BAD = Quality.GOOD, Quality.BAD


def samples(U, **columns):
    n = len(U)
    steady = {"p1": [200.0] * n, "p2": [50.0] * n, "Q": [100.0] * n, "T": [40.0] * n}
    t = np.arange(n) * 10_000_000
    return Samples.of(t=t, U=U, **{**steady, **columns})


def judge(gate, *batches):
    state, quality = gate.initial_state(), []
    for batch in batches:
        state, judged = gate.update(state, batch)
        quality += judged.quality.tolist()
    return quality, state.counters


def limited(signal, **limits):
    plausible = {s: SignalLimits(*s.plausible) for s in SENSORS}
    low, high = signal.plausible
    return QualityGate({**plausible, signal: SignalLimits(**{"low": low, "high": high, **limits})})


def test_constant_signals_jumps_and_slightly_negative_flow_are_good_by_default():
    U = [0.0, 100.0] * 500 + [50.0] * 5000
    quality, counters = judge(QualityGate(), samples(U, Q=[-0.5] * len(U)))
    assert set(quality) == {GOOD}
    assert set(counters.values()) == {0}


@pytest.mark.parametrize("broken", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["U", "p1", "p2", "Q"])
def test_what_is_no_number_is_bad_and_counted(name, broken):
    columns = {"U": [1.0, 2.0, 3.0], name: [1.0, broken, 3.0]}
    quality, counters = judge(QualityGate(), samples(**columns))
    assert quality == [GOOD, BAD, GOOD]
    assert counters["not_finite"] == 1


def test_a_value_beyond_all_sensors_is_bad():
    quality, counters = judge(QualityGate(), samples([1.0, 2.0], Q=[1e308, 5.0]))
    assert quality == [BAD, GOOD]
    assert counters["out_of_range"] == 1


def test_no_reading_of_the_temperature_is_no_fault_but_a_wrong_one_is():
    batch = samples([1.0, 2.0, 3.0], T=[np.nan, np.inf, 40.0])
    assert judge(QualityGate(), batch)[0] == [GOOD, BAD, GOOD]


def test_uncertain_teaches_only_where_it_is_allowed_to():
    batch = samples([1.0, 2.0])
    batch.quality[1] = Quality.UNCERTAIN
    assert judge(QualityGate(), batch)[0] == [GOOD, BAD]
    assert judge(QualityGate(use_uncertain=True), batch)[0] == [GOOD, Quality.UNCERTAIN]


def test_a_frozen_sensor_is_found_after_its_time_and_forgiven_when_it_moves():
    gate = limited(Signal.Q, frozen_s=0.05)
    Q = [1.0] * 10 + [2.0] * 3
    quality, counters = judge(gate, samples([1.0] * 13, Q=Q))
    assert quality == [GOOD] * 6 + [BAD] * 4 + [GOOD] * 3
    assert counters["frozen"] == 4


def test_a_step_steeper_than_the_rate_is_bad_once():
    gate = limited(Signal.P1, max_rate_per_s=1000.0)
    quality, counters = judge(gate, samples([1.0] * 4, p1=[100.0, 105.0, 190.0, 190.0]))
    assert quality == [GOOD, GOOD, BAD, GOOD]
    assert counters["too_fast"] == 1


def test_a_spike_is_bad_and_a_step_is_believed_after_its_third_sample():
    gate = limited(Signal.Q, spike=10.0)
    Q = [50.0] * 5 + [90.0] + [50.0] * 5 + [90.0] * 5
    quality, _ = judge(gate, samples([1.0] * len(Q), Q=Q))
    assert quality == [GOOD] * 5 + [BAD] + [GOOD] * 5 + [BAD, BAD] + [GOOD] * 3


@given(arrays(np.float64, (40, 5), elements=st.floats()), st.integers(0, 40))
def test_cutting_the_stream_changes_nothing(values, cut):
    gate = QualityGate(
        {
            s: SignalLimits(-1e3, 1e3, frozen_s=0.02, max_rate_per_s=1e4, spike=100.0)
            for s in SENSORS
        }
    )
    U, p1, p2, Q, T = values.T
    batch = samples(U, p1=p1, p2=p2, Q=Q, T=T)
    assert judge(gate, batch[:cut], batch[cut:]) == judge(gate, batch)
