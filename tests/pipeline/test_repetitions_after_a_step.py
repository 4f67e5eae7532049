"""Messages from before a step of the source's clock that come again after it."""

import numpy as np
import pytest

from valvemap.pipeline.alignment import COUNTER_NAMES, Alignment, AlignmentSettings
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.data_changes import DataChanges

START, STEP, DAY = 1_800_000_000_000_000_000, 100_000_000, 86_400_000_000_000


def samples(first, n, ahead=0):
    """The changes of U, p1, p2, Q, T of n samples of one valve without running number."""
    number = first + np.arange(n)
    values = np.stack([number % 100 + 0.1 * k for k in range(5)], axis=1)
    return DataChanges(
        item=np.tile(np.arange(5, dtype=np.int32), n),
        value=values.ravel(),
        status=np.zeros(5 * n, np.uint32),
        source_time=np.repeat(START + ahead + number * STEP, 5),
    )


def learnt(*messages):
    """Times of all samples after messages, each half a second after the one before; counters."""
    arrivals = Arrivals(["V1"], Alignment(AlignmentSettings(), optional=(("T",),)))
    times = []
    for number, changes in enumerate(messages):
        arrivals.announce(changes, 1000.0 + 0.5 * number)
        times += arrivals.take(changes).samples.t.tolist()
    times += [t for part in arrivals.finish() for t in part.samples.t.tolist()]
    return times, arrivals.counts(np.array([0]))[0].tolist()


BEFORE, AFTER, LATER = samples(0, 5), samples(5, 5, -DAY), samples(10, 5, -DAY)
JOINED = DataChanges.concatenate


@pytest.mark.parametrize(
    "messages",
    [
        (BEFORE, AFTER, BEFORE, LATER),
        (BEFORE, JOINED([AFTER, samples(2, 1)]), LATER),
        (JOINED([BEFORE, AFTER, samples(1, 2), LATER]),),
        (BEFORE, BEFORE, AFTER, AFTER, BEFORE, LATER),
    ],
)
def test_a_repetition_from_before_a_step_back_is_counted_and_not_learnt(messages):
    times, counts = learnt(*messages)
    once = np.unique(np.concatenate([part.source_time for part in (BEFORE, AFTER, LATER)]))
    assert sorted(times) == once.tolist()
    more = sum(map(len, messages)) - 5 * len(once)
    assert counts[COUNTER_NAMES.index("duplicates")] == more


def test_other_samples_at_the_times_of_former_ones_are_learnt():
    """The clock comes to the same times again, and the valve stands elsewhere."""
    back, again = samples(50, 5, -50 * STEP), samples(55, 5, -55 * STEP + DAY)
    times, _ = learnt(samples(0, 5, DAY), back, again)
    assert len(times) == 15
