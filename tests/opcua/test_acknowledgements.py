"""Received messages are acknowledged, or with commits only stored ones."""

from valvemap.opcua_source.acknowledgements import Acknowledgements


def numbers(sent):
    return [one.SequenceNumber for one in sent]


def test_what_was_received_is_acknowledged_once():
    ours = Acknowledgements(7)
    ours.add(1)
    ours.add(2)
    assert ours.kept_back is None
    sent = ours.take()
    assert numbers(sent) == [1, 2]
    assert {one.SubscriptionId for one in sent} == {7}
    assert ours.take() == []


def test_with_commits_only_what_was_committed_is_acknowledged():
    ours = Acknowledgements(7)
    ours.hold_back()
    for number in (4, 5, 6):
        ours.add(number)
    ours.commit(8, 6)  # of another subscription
    assert ours.take() == []
    ours.commit(7, 5)
    assert ours.known == {4, 5, 6}
    assert numbers(ours.take()) == [4, 5]
    assert ours.kept_back == (6,)


def test_numbers_wrap_and_a_commit_behind_the_wrap_reaches_those_before_it():
    ours = Acknowledgements(7)
    ours.hold_back()
    for number in (2**32 - 2, 2**32 - 1, 1, 2):
        ours.add(number)
    ours.commit(7, 1)
    assert numbers(ours.take()) == [2**32 - 2, 2**32 - 1, 1]


def test_a_next_connection_sends_what_the_last_did_not():
    before, after = Acknowledgements(7), Acknowledgements(7)
    before.add(1)
    before.hold_back()
    before.add(2)
    after.continue_from(before.unsent, before.kept_back)
    assert after.known == {1, 2}
    assert numbers(after.take()) == [1]
    after.commit(7, 2)
    assert numbers(after.take()) == [2]
