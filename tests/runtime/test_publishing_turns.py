import pytest

from valvemap.runtime.publishing_turns import VALVES_AT_ONCE, PublishingTurns

STALE_S = 2.0


def shown(valves, cost_s, seconds, *, samples_wait=False, stale_s=STALE_S):
    """Ages at which results were replaced that had been called good, s; and whether at the end."""
    turns, now, ages = PublishingTurns(0.25, stale_s), 0.0, []
    last, good = dict.fromkeys(range(valves), 0.0), dict.fromkeys(range(valves), False)
    while now < seconds:
        turns.add(range(valves), now)
        while not turns.are_due(now):
            now += 0.001
        some = turns.next(now)
        ages += [now - last[valve] for valve in some if good[valve]]
        for valve in some:
            last[valve], good[valve] = now, not turns.late
        began, now = now, now + cost_s * len(some)
        turns.pause(began, now, samples_wait=samples_wait)
    return ages, turns.late


@pytest.mark.parametrize("cost_s", [0.0001, 0.0004, 0.001, 0.004])
@pytest.mark.parametrize("valves", [1, 64, 1_000, 3_000])
@pytest.mark.parametrize("samples_wait", [False, True])
def test_nothing_is_called_good_for_longer_than_it_may_be(valves, cost_s, samples_wait):
    ages, _ = shown(valves, cost_s, 60.0, samples_wait=samples_wait)
    settled = ages[2 * valves :]  # how long it takes shows in the first rounds
    assert not [age for age in settled if age > STALE_S + 0.5]


def test_a_thousand_valves_are_shown_within_a_second_if_nothing_else_waits():
    ages, late = shown(1_000, 0.0004, 30.0)
    assert not late
    assert max(ages[1_000:]) < 1.0
    unhurried, _ = shown(1_000, 0.0004, 30.0, samples_wait=True)
    assert max(unhurried[1_000:]) > 1.4


def test_many_valves_that_are_fresh_leave_nine_tenths_of_the_time_to_samples():
    turns, now, spent = PublishingTurns(0.25, STALE_S), 0.0, 0.0
    while now < 10.0:
        turns.add(range(1_000), now)
        while not turns.are_due(now):
            now += 0.001
        began, now = now, now + 0.00004 * len(turns.next(now))
        spent += now - began
        turns.pause(began, now, samples_wait=False)
    assert 0.08 < spent / now < 0.11


def test_who_asks_for_fresher_results_gets_them_sooner():
    ages, late = shown(500, 0.0004, 30.0, stale_s=0.5)
    assert not late
    assert max(ages[500:]) < 0.5


def test_what_was_doubted_is_shown_again_when_all_is_well():
    turns = PublishingTurns(0.25, STALE_S)
    turns.add([1, 2], 0.0)
    assert (turns.next(1.95), turns.late) == ([1, 2], True)
    assert (turns.next(2.0), turns.late) == ([1, 2], False)
    assert len(turns) == 0


def test_who_waits_keeps_its_place():
    turns = PublishingTurns(0.25, STALE_S)
    turns.add(range(VALVES_AT_ONCE + 1), 0.0)
    assert turns.next(0.1) == list(range(VALVES_AT_ONCE))
    turns.add(range(VALVES_AT_ONCE + 1), 0.2)
    assert turns.next(0.3)[:2] == [VALVES_AT_ONCE, 0]


def test_a_stall_in_a_publication_does_not_prolong_the_pause():
    turns = PublishingTurns(0.25, STALE_S)
    turns.add([0], 0.0)
    turns.next(0.0)
    turns.pause(0.0, 3600.0, samples_wait=False)
    turns.add([0], 3600.1)
    assert not turns.are_due(3600.1)
    assert turns.are_due(3601.0)
