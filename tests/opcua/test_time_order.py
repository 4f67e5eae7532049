"""Messages that hold seconds of changes, signal by signal, as after an interruption."""

import numpy as np
import pytest

from valvemap.opcua_source.time_order import AS_SENT_NS, in_order_of_time
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.timing import Timing, TimingSettings
from valvemap.vocabulary.signals import PER_VALVE, Signal

START, PERIOD, APART = 1_700_000_000 * 10**9, 50_000_000, 3_000_000
SIGNALS = (Signal.U, Signal.P1, Signal.P2, Signal.Q, Signal.T)


def columns(changes):
    return changes.item, changes.value, changes.status, changes.source_time


def staggered(scans, seed=0):
    """Scans of five signals, 3 ms apart, in the order of time."""
    rng = np.random.default_rng(seed)
    item = np.tile(np.array(SIGNALS, np.int32), scans)
    place = np.tile(np.arange(len(SIGNALS)), scans)
    time = START + PERIOD * np.repeat(np.arange(scans), len(SIGNALS)) + APART * place
    value = 100.0 + np.sin(0.02 * time * 1e-8) + rng.normal(0.0, 0.1, len(item))
    return DataChanges(item, value, np.zeros(len(item), np.uint32), time)


def messages(changes, ends):
    """Messages that end at the given times, s, each sorted by signal."""
    message = np.searchsorted(np.array(ends), (changes.source_time - START) * 1e-9)
    for number in np.unique(message):
        own = changes[message == number]
        yield own[np.argsort(own.item, kind="stable")]


@pytest.mark.parametrize("ends", [[6.0, 6.4, 9.0], [0.3, 8.0, 8.1], [2.0, 4.0, 6.0, 8.0]])
def test_seconds_in_one_message_lose_no_scan_and_make_no_signal_on_change(ends):
    changes = staggered(200)
    timing = Timing(TimingSettings(), optional=(("T",),))
    out = [timing.take(in_order_of_time(sent)) for sent in messages(changes, ends)]
    (valve,) = timing.valves
    assert "3 ms after the scan's first" in valve.words.sentences({})[1]
    assert valve.not_made == 0
    done = DataChanges.concatenate(out)
    assert (done.item == Signal.Q).sum() >= 199 - 2 * valve.pending


def test_a_short_message_stays_as_sent():
    (sent,) = messages(staggered(4), [1.0])
    assert int(np.ptp(sent.source_time)) <= AS_SENT_NS
    assert in_order_of_time(sent) is sent
    assert len(in_order_of_time(DataChanges.empty())) == 0


@pytest.mark.parametrize("seed", range(20))
def test_each_item_keeps_its_order_and_no_other_is_ahead_of_time(seed):
    rng = np.random.default_rng(seed)
    n = 300
    item = rng.integers(0, 9, n).astype(np.int32) * PER_VALVE
    time = START + np.sort(rng.integers(0, 10**10, n))
    if seed % 2:  # a value or a whole stretch whose clock was set back
        time[100:200] -= 2 * 10**9
    sent = DataChanges(item, np.arange(n) * 1.0, np.zeros(n, np.uint32), time)
    sent = sent[np.argsort(item, kind="stable")]
    done = in_order_of_time(sent)
    assert sorted(done.value) == sorted(sent.value)
    for one in np.unique(item):
        assert np.array_equal(done.value[done.item == one], sent.value[sent.item == one])
    if not seed % 2:
        assert (np.diff(done.source_time) >= 0).all()
