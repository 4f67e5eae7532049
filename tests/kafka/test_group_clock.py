"""A sample that is dated far ahead is not taken, and makes no later one late."""

import numpy as np
import pytest

pytest.importorskip("pyarrow")

from support.fleet import block, catalogue, feed, group
from support.plant import START
from valvemap.errors import BlockError
from valvemap.kafka.group_clock import AHEAD_NS, CONFIRMED, GAP_NS, LATEST_NS, UNSET_NS, plausible

DAY_NS = 86_400_000_000_000
YEAR_NS = 365 * DAY_NS
NOW = 1_700_000_000_000_000_000


def run(*blocks, sent=None, newest=0):
    """How many of each block's samples are taken, one after the other."""
    ahead, found = (), []
    for number, times in enumerate(blocks, 1):
        t = np.atleast_1d(np.asarray(times, np.int64))
        taken, ahead = plausible(t, number, newest, sent, ahead)
        newest = max(newest, int(t[taken].max(initial=0)))
        found.append(int(taken.sum()))
    return found


def test_samples_no_later_than_their_message_are_taken_however_long_the_source_was_off():
    years = [NOW - 30 * YEAR_NS, NOW - 20 * YEAR_NS, NOW - DAY_NS, NOW, NOW + AHEAD_NS]
    assert run(*years, sent=NOW) == [1] * 5


def test_a_sample_ahead_of_its_message_is_not_taken_and_the_others_of_its_block_are():
    assert run([NOW, NOW + AHEAD_NS + 1, NOW - 1], sent=NOW) == [2]
    assert run(NOW, NOW + 90 * YEAR_NS, NOW + 1, sent=NOW + 1) == [1, 0, 1]


def test_without_the_messages_time_the_newest_sample_is_the_clock():
    assert run(NOW, NOW + GAP_NS, NOW + 2 * GAP_NS + 1, NOW + GAP_NS) == [1, 1, 0, 1]
    assert run([NOW, NOW + 10 * YEAR_NS, NOW + 1]) == [2]


def test_a_source_whose_clock_runs_ahead_is_taken_from_its_first_block_on():
    ahead = NOW + 50 * DAY_NS
    assert run(ahead, ahead + 1, ahead + DAY_NS, ahead + 2, sent=NOW) == [1, 1, 0, 1]


def test_a_clock_that_was_set_is_accepted_after_three_blocks_that_agree():
    later = NOW + 10 * UNSET_NS
    found = run(*(later + k for k in range(5)), sent=NOW)
    assert found == [0] * (CONFIRMED - 1) + [1] * (5 - CONFIRMED + 1)
    apart = [NOW + k * 10 * UNSET_NS for k in range(1, 6)]
    assert run(*apart, sent=NOW) == [0] * 5


def test_a_block_that_is_repeated_confirms_no_clock():
    ahead = ()
    for _ in range(5):
        taken, ahead = plausible(np.array([NOW + 2 * UNSET_NS]), 7, NOW, NOW, ahead)
        assert not taken.any()


@pytest.mark.parametrize("t", [-1, -(2**63), LATEST_NS + 1, 2**63 - 1])
def test_times_that_no_clock_has_are_never_taken(t):
    for sent in (None, NOW):
        assert run(*[t] * 5, NOW, sent=sent) == [0] * 5 + [1]


@pytest.mark.parametrize("sent", [None, START, START - 50 * DAY_NS])
def test_a_valve_learns_all_its_honest_samples_around_one_of_2116(sent):
    """In a block with honest ones, in a separate block, and with a takeover after each block."""
    plan, far = catalogue().groups["north.0"], START + 90 * YEAR_NS
    alone, one = group(plan), group(plan)
    for number in range(1, 22):
        honest = block(plan, number, (25, 25, 25), seed=number, first=25 * number)
        feed(alone, [honest])
        t = honest.samples.samples.t.copy()
        worse = block(plan, number, (26, 25, 25), seed=number, first=25 * number)
        for name in ("t", "U", "p1", "p2", "Q", "T", "quality"):
            whole = np.insert(getattr(honest.samples.samples, name), 25, 0)
            getattr(worse.samples.samples, name)[:] = whole
        assert len(t) == 75
        worse.samples.samples.t[25] = far
        list(one.take(worse, sent))
        with pytest.raises(BlockError, match="far off the group's clock"):
            list(one.take(block(plan, number, (1, 0, 0), first=10**12), sent))
        memory, one = one.to_bytes(), group(plan)
        one.remember(memory)
    assert one.counts["ahead"] == 21 * 2
    for valve in range(3):
        ours, theirs = (
            one.identification.valves.state(valve),
            alone.identification.valves.state(valve),
        )
        assert ours.lanes["RLS"].count == 21 * 25
        for name, lane in ours.lanes.items():
            assert lane.state.to_bytes("") == theirs.lanes[name].state.to_bytes("")
