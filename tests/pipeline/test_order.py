"""Samples with a running number: each once and in order, however they come."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.data_changes import DataChanges

START, STEP, SECOND = 1_800_000_000_000_000_000, 10_000_000, 1_000_000_000
ORDERED = Alignment(AlignmentSettings(), optional=(("T",),), has_sequence=(True,))
BY_TIME = Alignment(AlignmentSettings(), optional=(("T",),))
LOSSES = ("late", "missing", "duplicates", "clock_steps", "gaps", "lost_by_time", "restarts")


def stream(numbers, t=None, first=0):
    """Each sample's six changes in a row; ``numbers`` as sent, ``t`` in ns."""
    numbers = np.asarray(numbers)
    n = len(numbers)
    t = START + (first + np.arange(n)) * STEP if t is None else np.asarray(t)
    values = np.stack([t / 7 % 100 + 3 * k for k in range(5)] + [numbers % 2**32], axis=1)
    return DataChanges(
        item=np.tile(np.arange(6, dtype=np.int32), n),
        value=values.ravel(),
        status=np.zeros(6 * n, np.uint32),
        source_time=np.repeat(t, 6),
    )


def shuffled(changes, delay_s, seed, *, whole=False):
    """The same changes, each delayed on its way by up to ``delay_s``; or whole samples."""
    rng = np.random.default_rng(seed)
    if whole:
        delays = np.repeat(rng.uniform(0, delay_s, len(changes) // 6), 6)
    else:
        delays = rng.uniform(0, delay_s, len(changes))
    return rows(changes, np.argsort(changes.source_time + delays * 1e9, kind="stable"))


def rows(changes, chosen):
    return DataChanges(
        changes.item[chosen],
        changes.value[chosen],
        changes.status[chosen],
        changes.source_time[chosen],
    )


def joined(*parts):
    return DataChanges.concatenate(parts)


def run(align, *batches, flush=False):
    """Times of the samples, all of their bits, and the counters that tell of a loss."""
    state, out = align.initial_state(), []
    for batch in batches:
        state, samples = align.update(state, batch)
        out += [samples[0]] if 0 in samples else []
    if flush:
        state, samples = align.flush(state, np.array([0]))
        out += [samples[0]] if 0 in samples else []
    times = [t for part in out for t in part.t.tolist()]
    bits = b"".join(
        np.stack([p.t.view(float), p.U, p.p1, p.p2, p.Q, p.T], axis=1).tobytes() for p in out
    )
    counters = align.counters(state, 0)
    assert counters["aligned"] == len(times)
    return times, bits, {name: counters[name] for name in LOSSES if counters[name]}


def cut(changes, seed):
    """Cut into batches anywhere."""
    rng = np.random.default_rng(seed)
    edges = np.unique(np.r_[0, rng.integers(0, len(changes), 20), len(changes)])
    return [changes[a:b] for a, b in pairwise(edges.tolist())]


@pytest.mark.parametrize("first", [0, 5321, 2**32 - 300])
@pytest.mark.parametrize("delay_s", [0.1, 0.9])
@pytest.mark.parametrize("whole", [True, False])
def test_what_comes_in_another_order_is_learnt_in_its_own(first, delay_s, whole):
    changes = stream(first + np.arange(1500))
    ordered = run(ORDERED, changes)
    for seed in range(3):
        mixed = shuffled(changes, delay_s, seed, whole=whole)
        assert run(ORDERED, *cut(mixed, seed)) == ordered, seed
    assert len(ordered[0]) == 1500
    assert ordered[2] == {}


def test_where_numbers_are_contiguous_nothing_waits():
    changes = stream(np.arange(300))
    state = ORDERED.initial_state()
    for k in range(300):
        state, samples = ORDERED.update(state, changes[6 * k : 6 * k + 6])
        assert samples[0].t.tolist() == [START + k * STEP]


def test_the_last_ten_seconds_sent_again_are_learnt_once_and_counted():
    changes = stream(77 + np.arange(1500))
    again = joined(changes[: 6 * 1200], changes[6 * 200 : 6 * 1200], changes[6 * 1200 :])
    times, bits, losses = run(ORDERED, again)
    assert (times, bits) == run(ORDERED, changes)[:2]
    assert losses == {"duplicates": 5 * 1000}


def test_everything_twice_at_once_is_learnt_once():
    changes = stream(np.arange(500))
    for chunk in (1, 6, 50):
        parts = [changes[k : k + chunk] for k in range(0, len(changes), chunk)]
        twice = joined(*(part for part in parts for _ in range(2)))
        times, bits, losses = run(ORDERED, twice, stream(np.arange(500, 900), first=500))
        assert (times, bits) == run(ORDERED, stream(np.arange(900)))[:2]
        assert losses == {"duplicates": 5 * 500}


def test_reordered_doubled_and_sent_again_the_bits_stay():
    changes = stream(np.arange(4000, 6000))
    ordered = run(ORDERED, changes)
    for seed in range(3):
        first = shuffled(changes, 0.9, seed)
        doubled = joined(*(first[k : k + 40] for k in range(0, len(first), 40) for _ in range(2)))
        whole = joined(doubled, rows(changes, slice(6 * 900, None)))
        times, bits, losses = run(ORDERED, *cut(whole, seed))
        assert (times, bits) == ordered[:2]
        assert losses == {"duplicates": 5 * 2000 + 5 * 1100}


def test_a_hole_is_waited_for_no_longer_than_it_may_and_counted():
    lost = [500, 501, 777]
    numbers = np.delete(np.arange(1500), lost)
    changes = stream(numbers, START + numbers * STEP)
    times, _, losses = run(ORDERED, changes)
    assert times == (START + numbers * STEP).tolist()
    assert losses == {"gaps": 3}
    state, samples = ORDERED.update(ORDERED.initial_state(), changes[: 6 * 600])
    assert samples[0].t[-1] == START + 499 * STEP  # 1 s of samples waits
    state, samples = ORDERED.update(state, changes[6 * 600 : 6 * 603])
    assert samples[0].t[-1] == START + 604 * STEP


def test_what_comes_after_it_was_given_up_is_late_and_what_comes_then_again_too():
    numbers = np.delete(np.arange(1000), 300)
    changes, lost = stream(numbers, START + numbers * STEP), stream([300], [START + 300 * STEP])
    losses = run(ORDERED, changes[: 6 * 600], lost, changes[6 * 600 :])[2]
    assert losses == {"gaps": 1, "late": 5}


def test_a_sample_without_one_of_its_signals_is_missing_not_a_gap():
    changes = stream(np.arange(1000))
    no_Q = rows(changes, np.delete(np.arange(6000), 6 * 400 + 3))
    times, _, losses = run(ORDERED, no_Q)
    assert len(times) == 999
    assert losses == {"missing": 1}


@pytest.mark.parametrize("room", [64, 4096])
@pytest.mark.parametrize("share", [0.02, 0.5, 0.9])
def test_what_queues_lost_of_some_signals_and_numbers_is_counted_once(share, room):
    align = Alignment(AlignmentSettings(max_pending=room), (("T",),), (True,))
    changes = stream(np.arange(2000))
    for seed in range(5):
        within = np.isin(np.arange(12000) // 6, np.arange(500, 1500))
        lost = within & (np.random.default_rng(seed).random(12000) < share)
        times, _, losses = run(align, rows(changes, ~lost))
        assert 2000 - len(times) == losses.get("gaps", 0) + losses.get("missing", 0), seed
        assert set(losses) <= {"gaps", "missing"}


def test_a_restarted_source_is_gone_on_with_and_what_it_cost_is_counted_by_time():
    before = stream(np.arange(1000, 1600))
    t = START + 655 * STEP + np.arange(900) * STEP
    times, _, losses = run(ORDERED, before, stream(np.arange(900), t))
    assert times == [*before.source_time[::6].tolist(), *t.tolist()]
    assert losses == {"restarts": 1, "lost_by_time": 55}
    for seed in range(3):
        mixed = shuffled(joined(before, stream(np.arange(900), t)), 0.3, seed)
        shuffled_times, _, losses = run(ORDERED, mixed)
        assert shuffled_times == times
        assert losses == {"restarts": 1, "lost_by_time": 55}


def test_an_announced_restart_is_gone_on_with_whatever_the_new_numbers():
    before, after = stream(np.arange(300)), stream(np.arange(500, 1200), first=360)
    state, first = ORDERED.update(ORDERED.initial_state(), before)
    state, waited = ORDERED.begin_anew(state, np.array([0]))
    state, then = ORDERED.update(state, after)
    assert len(first[0]) == 300
    assert len(waited) == 0
    assert len(then[0]) == 700
    counters = ORDERED.counters(state, 0)
    assert (counters["gaps"], counters["restarts"], counters["lost_by_time"]) == (0, 1, 60)


@pytest.mark.parametrize("step_s", [-3600.0, -10.0, -0.5, 0.5, 30.0, 3600.0])
def test_a_clock_that_is_set_costs_nothing_where_numbers_go_on(step_s):
    t = START + np.arange(1500) * STEP
    t[700:] += round(step_s * 1e9)
    changes = stream(np.arange(1500), t)
    times, bits, losses = run(ORDERED, changes)
    assert times == t.tolist()
    assert losses == ({"clock_steps": 1} if step_s < 0 else {})
    if step_s != 0.5:  # what is late by less than a hole may last has two orders
        again = joined(changes[: 6 * 720], changes[6 * 680 : 6 * 720], changes[6 * 720 :])
        assert run(ORDERED, again)[:2] == (times, bits)


def test_a_source_whose_clock_was_reset_when_it_restarted_is_gone_on_with():
    before = stream(np.arange(90_000, 90_600))
    after = stream(np.arange(800), 1_000_000_000 + np.arange(800) * STEP)
    times, _, losses = run(ORDERED, before, after)
    assert len(times) == 1400
    assert losses == {"restarts": 1}


def test_a_restart_is_found_while_the_first_samples_of_the_run_before_still_wait():
    before, after = stream(np.arange(7, 12)), stream(np.arange(7, 107), first=30)
    times, _, losses = run(ORDERED, before, after, flush=True)
    assert times == [*before.source_time[::6].tolist(), *after.source_time[::6].tolist()]
    assert losses == {"restarts": 1}


@pytest.mark.parametrize("lost", [0, 5])
def test_a_clock_set_back_after_a_restart_makes_no_later_sample_old(lost):
    numbers = np.delete(np.arange(400), np.s_[220 : 220 + lost])
    t = START + (700 + numbers) * STEP
    t[200:] -= 3_600 * SECOND
    times, _, losses = run(ORDERED, stream(np.arange(100, 600)), stream(numbers, t), flush=True)
    assert times[500:] == t.tolist()
    assert losses.get("gaps", 0) == lost
    assert losses["restarts"] == 1


def test_a_clock_set_back_before_the_first_sample_left_drops_nothing_that_is_incomplete():
    numbers = np.arange(7, 407)
    t = START + numbers * STEP
    t[20:] -= 3_600 * SECOND
    changes = stream(numbers, t)
    k = 100  # its number comes 20 samples later; those before it have waited long enough by then
    number, later = 6 * k + 5, 6 * (k + 20)
    late = np.r_[0:number, number + 1 : later, number, later : len(changes)]
    times, _, losses = run(ORDERED, rows(changes, late), flush=True)
    assert times == t.tolist()
    assert losses == {"clock_steps": 1}


def test_without_its_numbers_a_valve_is_gone_on_with_by_time():
    changes = stream(np.arange(600))
    silent = changes.item[:] == 5
    silent[: 6 * 300] = False
    times, _, losses = run(ORDERED, rows(changes, ~silent), flush=True)
    assert times == (START + np.arange(600) * STEP).tolist()
    assert losses == {}


def test_a_clock_set_back_behind_lost_samples_is_found_though_times_increase():
    """13 and 14 are on their way when 15 is flushed, whose clock was set back by 3 s."""
    slow = AlignmentSettings(reorder_ns=5 * SECOND)
    align = Alignment(slow, optional=(("T",),), has_sequence=(True,))
    numbers = np.array([*range(13), 15])
    t = START + numbers * 13 * SECOND // 10
    t[-1] -= 3 * SECOND
    state, _ = align.update(align.initial_state(), stream(numbers, t))
    state, _ = align.flush(state, np.array([0]))
    late = np.array([13, 14])
    state, _ = align.update(state, stream(late, START + late * 13 * SECOND // 10))
    counted = align.counters(state, 0)
    named = {name: counted[name] for name in LOSSES if counted[name]}
    assert named == {"late": 10, "gaps": 2, "clock_steps": 1}


def test_a_number_that_is_on_its_way_when_the_buffer_is_flushed_is_not_guessed():
    """Sample 8, and the number of sample 9, come in the next message: neither is a restart."""
    numbers = np.array([0, 1, 2, 3, 4, 6, 7, 9])
    changes = stream(numbers, START + numbers * (SECOND // 2))
    state, samples = ORDERED.update(ORDERED.initial_state(), changes[:-1])
    state, held = ORDERED.flush(state, np.array([0]))
    late = stream(np.array([8]), np.array([START + 4 * SECOND]))
    state, rest = ORDERED.update(state, joined(late, changes[-1:]))
    learnt = [len(part.samples) for part in (samples, held, rest)]
    counted = ORDERED.counters(state, 0)
    assert (sum(learnt), counted["restarts"], counted["gaps"]) == (9, 0, 1)
    state, silent = ORDERED.update(
        state, stream(np.array([10]), np.array([START + 5 * SECOND]))[:-1]
    )
    assert len(silent.samples) == 0
    assert len(ORDERED.flush(state, np.array([0]))[1].samples) == 1  # no number comes any more


def test_when_many_samples_lack_a_signal_the_oldest_make_room():
    align = Alignment(AlignmentSettings(max_pending=64), (("T",),), (True,))
    changes = stream(np.arange(2000))
    no_Q = rows(changes, (changes.item != 3) | (np.arange(12000) < 600))
    times, _, losses = run(align, no_Q)
    assert len(times) == 100
    assert 1900 - 64 <= losses["missing"] <= 1900
    assert set(losses) == {"missing"}


def test_without_a_number_what_has_left_is_known_by_its_time():
    changes = stream(np.arange(1500))
    again = joined(changes[: 6 * 1200], changes[6 * 200 : 6 * 1200], changes[6 * 1200 :])
    times, bits, losses = run(BY_TIME, again)
    assert (times, bits) == run(BY_TIME, changes)[:2]
    assert losses == {"duplicates": 5 * 1000}


def test_without_a_number_a_loss_is_counted_by_the_usual_pace():
    kept = np.delete(np.arange(2000), [*range(500, 700), 1000, *range(1200, 1205)])
    times, _, losses = run(BY_TIME, stream(kept, START + kept * STEP))
    assert len(times) == 2000 - 206
    assert losses == {"lost_by_time": 206}


def test_a_source_that_becomes_slower_loses_nothing():
    t = START + np.cumsum(np.r_[np.full(300, STEP), np.full(300, 10 * STEP)])
    assert run(BY_TIME, stream(np.arange(600), t))[2] == {}


def test_without_a_number_samples_wait_for_earlier_ones_where_that_is_asked_for():
    align = Alignment(AlignmentSettings(reorder_by_time_ns=SECOND), (("T",),))
    changes = stream(np.arange(1500))
    ordered = run(align, changes, flush=True)
    assert len(ordered[0]) == 1500
    for seed in range(3):
        assert run(align, shuffled(changes, 0.9, seed), flush=True) == ordered


wild = st.lists(
    st.tuples(st.integers(0, 5), st.integers(0, 12), st.sampled_from([0, 1, 2, 3, 9, 2**31, -1])),
    max_size=150,
)


@settings(max_examples=200)
@given(wild, st.integers(0, 2**31), st.booleans())
def test_a_stream_cut_anywhere_gives_the_same_samples(changes, seed, numbered):
    align = Alignment(AlignmentSettings(max_pending=16), (("T",),), (numbered,))
    many = DataChanges(
        item=np.array([c[0] for c in changes], np.int32),
        value=np.array([c[2] for c in changes], float),
        status=np.zeros(len(changes), np.uint32),
        source_time=np.array([c[1] * SECOND for c in changes], np.int64),
    )
    whole = run(align, many)
    assert run(align, *cut(many, seed)) == whole if changes else True
