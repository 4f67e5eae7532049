from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.data_changes import DataChanges
from valvemap.vocabulary.signals import PER_VALVE, Signal

SECOND = 1_000_000_000
BAD, UNCERTAIN = 0x80000000, 0x40000000
ONE_VALVE = Alignment(AlignmentSettings(), optional=(("T",),))


def changes(*rows):
    """Each row: signal, time in s, value and, if it has one, status; on valve 0."""
    full = [(*row, 0)[:4] for row in rows]
    return DataChanges(
        item=np.array([r[0] for r in full], np.int32),
        value=np.array([r[2] for r in full], np.float64),
        status=np.array([r[3] for r in full], np.uint32),
        source_time=np.array([round(r[1] * SECOND) for r in full], np.int64),
    )


def sample(t, value=1.0, signals=range(5), status=0):
    return [(signal, t, value, status) for signal in signals]


def run(align, *batches):
    state, out = align.initial_state(), []
    for batch in batches:
        state, samples = align.update(state, batch)
        out += [samples[0]] if 0 in samples else []
    times = [t / SECOND for part in out for t in part.t.tolist()]
    return times, align.counters(state, 0), out


def test_five_signals_of_one_time_become_one_sample():
    rows = [(s, 1.0, 10.0 + s) for s in reversed(range(5))]
    times, counters, (samples,) = run(ONE_VALVE, changes(*rows))
    assert times == [1.0]
    assert (samples.U[0], samples.p1[0], samples.p2[0]) == (10.0, 11.0, 12.0)
    assert (samples.Q[0], samples.T[0]) == (13.0, 14.0)
    assert counters["aligned"] == 1
    assert counters["missing"] == 0


def test_a_server_that_groups_by_item_is_aligned_as_one_that_groups_by_time():
    grid = [(s, t, 100.0 * s + t) for s in range(5) for t in range(200)]
    times, counters, _ = run(ONE_VALVE, changes(*grid))
    assert times == list(range(200))
    assert counters["missing"] == counters["late"] == 0


def test_a_signal_that_moved_on_makes_its_sample_missing_and_a_straggler_late():
    no_Q = [s for s in range(5) if s != Signal.Q]
    batch = [*sample(0), *sample(1, signals=no_Q), *sample(2)]
    times, counters, _ = run(ONE_VALVE, changes(*batch), changes((Signal.Q, 1.0, 5.0)))
    assert times == [0, 2]
    assert (counters["missing"], counters["late"]) == (1, 1)


def test_before_the_first_sample_nothing_counts_as_missing():
    batch = [(Signal.U, 0.5, 1.0), *sample(1), *sample(2)]
    times, counters, _ = run(ONE_VALVE, changes(*batch))
    assert times == [1, 2]
    assert counters["missing"] == 0


def test_the_same_time_of_the_same_signal_is_a_duplicate():
    times, counters, _ = run(ONE_VALVE, changes(*sample(0), *sample(0), *sample(1)))
    assert times == [0, 1]
    assert counters["duplicates"] == 5


def test_times_within_the_tolerance_belong_together():
    align = Alignment(AlignmentSettings(tolerance_ns=2_000_000), optional=(("T",),))
    batch = [(s, t + 0.0005 * s, 1.0) for t in range(3) for s in range(5)]
    times, _, _ = run(align, changes(*batch))
    assert times == [0, 1, 2]
    assert run(ONE_VALVE, changes(*batch))[0] == []


def test_a_silent_signal_is_waited_for_only_within_bounds():
    align = Alignment(AlignmentSettings(max_pending=64), optional=(("T",),))
    no_Q = [s for s in range(5) if s != Signal.Q]
    batch = [row for t in range(1, 1000) for row in sample(t / 100, signals=no_Q)]
    state, _ = align.update(align.initial_state(), changes(*sample(0)))
    state, _ = align.update(state, changes(*batch))
    assert state.slots.shape[1] == 64
    assert align.counters(state, 0)["missing"] == 999 - 64


def test_a_clock_that_steps_back_costs_what_was_under_way_and_no_more():
    before = [row for t in range(3600, 3610) for row in sample(t)]
    after = [row for t in range(10) for row in sample(t)]
    times, counters, _ = run(ONE_VALVE, changes(*before), changes(*after))
    assert times == [*range(3600, 3610), *range(10)]
    assert counters["clock_steps"] == 1
    assert counters["late"] == 0


def test_a_clock_that_jumps_ahead_costs_nothing():
    batch = [row for t in [0, 1, 7200, 7201] for row in sample(t)]
    times, counters, _ = run(ONE_VALVE, changes(*batch))
    assert times == [0, 1, 7200, 7201]
    assert counters["missing"] == 0


def test_a_held_temperature_serves_until_it_is_too_old():
    hold = {Signal.T: 10 * SECOND}
    align = Alignment(AlignmentSettings(hold_ns=hold), optional=(("T",),))
    batch = [(Signal.T, 0, 40.0)]
    batch += [row for t in (0, 10, 11) for row in sample(t, signals=range(4))]
    times, _, (samples,) = run(align, changes(*batch))
    assert times == [0, 10, 11]
    np.testing.assert_array_equal(samples.T, [40.0, 40.0, np.nan])
    assert samples.quality.tolist() == [0, 0, 2]


def test_a_valve_without_a_thermometer_needs_none():
    align = Alignment(AlignmentSettings(), optional=((),))
    times, _, (samples,) = run(align, changes(*sample(0, signals=range(4))))
    assert times == [0]
    assert np.isnan(samples.T[0])
    assert samples.quality[0] == 0


def test_the_worst_signal_decides_the_quality():
    rows = [*sample(0), *sample(1, signals=range(4)), (4, 1, 1.0, UNCERTAIN)]
    rows += [*sample(2, signals=range(4)), (4, 2, 1.0, BAD + 0x00310000)]
    _, _, (samples,) = run(ONE_VALVE, changes(*rows))
    assert samples.quality.tolist() == [0, 1, 2]


def test_valves_do_not_meet():
    align = Alignment(AlignmentSettings(), optional=(("T",), ()))
    one = changes(*sample(0))
    two = DataChanges(one.item + np.int32(PER_VALVE), one.value * 2, one.status, one.source_time)
    _, samples = align.update(
        align.initial_state(), DataChanges.concatenate([one[:3], two, one[3:]])
    )
    assert samples[0].Q.tolist() == [1.0]
    assert samples[1].Q.tolist() == [2.0]


@given(
    st.lists(st.tuples(st.integers(0, 5), st.integers(0, 30), st.integers(0, 3)), max_size=120),
    st.lists(st.integers(0, 120), max_size=5),
)
def test_a_stream_cut_anywhere_gives_the_same_samples(rows, cuts):
    stream = changes(*[(s, t / 10, v) for s, t, v in rows])
    whole = run(ONE_VALVE, stream)
    edges = sorted({0, len(stream), *[min(c, len(stream)) for c in cuts]})
    parts = run(ONE_VALVE, *[stream[a:b] for a, b in pairwise(edges)])
    assert parts[:2] == whole[:2]


@given(
    st.lists(
        st.tuples(
            st.integers(0, 5),
            st.integers(-(2**62), 2**62),
            st.floats(),
            st.integers(0, 2**32 - 1),
        ),
        max_size=100,
    )
)
def test_whatever_comes_samples_leave_in_order_of_time_and_all_is_counted(rows):
    stream = DataChanges(
        item=np.array([r[0] for r in rows], np.int32),
        value=np.array([r[2] for r in rows], np.float64),
        status=np.array([r[3] for r in rows], np.uint32),
        source_time=np.array([r[1] for r in rows], np.int64),
    )
    _, counters, out = run(ONE_VALVE, stream)
    if counters["clock_steps"] == 0:
        assert all((np.diff(part.t) > 0).all() for part in out)
    assert counters["aligned"] == sum(map(len, out))
