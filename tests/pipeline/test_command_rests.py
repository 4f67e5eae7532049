"""A command that moved in every sample, then rests at a source that sends on change alone."""

import numpy as np
import pytest

from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.timing import Timing, TimingSettings
from valvemap.vocabulary.signals import PER_VALVE, Signal

PERIOD = 50_000_000
START = 1_800_000_000 * 10**9
ORDER = (Signal.U, Signal.P1, Signal.P2, Signal.Q)


def arrivals(*, numbered=False):
    optional, has_sequence = ((),), (numbered,)
    return Arrivals(
        ["V"],
        Alignment(AlignmentSettings(), optional=optional, has_sequence=has_sequence),
        Timing(TimingSettings(), optional=optional, has_sequence=has_sequence),
    )


def scans(stretches, *, skew=0, numbered=False, sends_unchanged=False):
    """Yield the changes of each scan; a stretch is its length and whether U is sent."""
    rng, k, U = np.random.default_rng(1), 0, 50.0
    for length, sends_U in stretches:
        for _ in range(length):
            if sends_U:
                U = 10.0 if sends_unchanged and k % 3 else float(rng.uniform(5, 95))
            values = {Signal.U: U, Signal.P1: 200 + rng.normal(), Signal.P2: 100 + rng.normal()}
            values[Signal.Q] = 0.1 * U * np.sqrt(values[Signal.P1] - values[Signal.P2])
            sent = [j for j in ORDER if sends_U or j != Signal.U]
            times = [START + k * PERIOD + skew * ORDER.index(j) for j in sent]
            values = [values[j] for j in sent]
            if numbered:
                sent, values, times = [*sent, Signal.SEQUENCE], [*values, k], [*times, times[-1]]
            item = np.array(sent, np.int32)
            assert item.max() < PER_VALVE
            yield DataChanges(
                item, np.array(values), np.zeros(len(item), np.uint32), np.array(times, np.int64)
            )
            k += 1


def taken(of, parts):
    """Return the times and U of all samples."""
    t, U = [], []
    for part in parts:
        samples = of.take(part)
        if 0 in samples:
            t += samples[0].t.tolist()
            U += samples[0].U.tolist()
    return np.array(t), np.array(U)


@pytest.mark.parametrize("skew", [0, 3_000_000], ids=["one timestamp", "staggered"])
@pytest.mark.parametrize("numbered", [False, True], ids=["", "with a running number"])
@pytest.mark.parametrize("moved", [20, 140, 400])
def test_no_sample_is_lost_when_a_command_comes_to_rest(moved, numbered, skew):
    of = arrivals(numbered=numbered)
    stretches = [(moved, True), (200, False), (50, True), (100, False), (3, True)]
    t, U = taken(of, scans(stretches, skew=skew, numbered=numbered))
    assert np.all(np.diff(t) > 0)
    n = sum(length for length, _ in stretches)
    assert len(t) >= n - (25 if moved == 20 or skew else 2)  # a horizon of 20 is still waiting
    resting = (t >= START + (moved + 1) * PERIOD) & (t < START + (moved + 199) * PERIOD)
    assert resting.sum() >= 190 - (20 if moved == 20 else 0)
    assert len(np.unique(U[resting])) == 1
    assert of.timing.holds.all()


def test_a_command_that_was_sent_unchanged_is_lost_when_it_is_silent():
    of = arrivals()
    t, _ = taken(of, scans([(140, True), (200, False)], sends_unchanged=True))
    assert len(t) == 140
    assert not of.timing.holds.any()


def test_a_pressure_that_is_silent_is_lost():
    of = arrivals()
    parts = list(scans([(340, True)]))
    parts[140:] = [part[part.item != Signal.P2] for part in parts[140:]]
    t, _ = taken(of, parts)
    assert len(t) == 140
    assert not of.timing.holds.any()


def test_a_silence_of_all_signals_is_a_loss():
    of = arrivals()
    taken(of, scans([(140, True)]))
    assert not of.timing.holds.any()


def test_a_command_that_was_bad_is_not_held():
    of = arrivals()
    parts = list(scans([(140, True), (200, False)]))
    last = parts[139]
    bad = np.where(last.item == Signal.U, np.uint32(0x80000000), last.status).astype(np.uint32)
    parts[139] = DataChanges(last.item, last.value, bad, last.source_time)
    t, _ = taken(of, parts)
    assert len(t) == 140


def test_a_restart_within_the_rest_loses_nothing():
    parts = list(scans([(140, True), (200, False)]))
    whole, first, second = arrivals(), arrivals(), arrivals()
    expected, _ = taken(whole, parts)
    before, _ = taken(first, parts[:148])  # eight samples wait for U
    second.resume(first.to_bytes())
    after, _ = taken(second, parts[148:])
    assert np.concatenate([before, after]).tolist() == expected.tolist()
