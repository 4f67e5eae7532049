"""Rejected messages are counted until it is quiet; what a dead letter says is only text."""

import pytest

from valvemap.kafka.rejections import Rejection, Rejections

UTC = 1_800_000_000_000_000_000


def test_the_newest_reason_counts_and_old_dead_letters_do_not():
    rejections = Rejections(600.0)
    letters = [
        Rejection("north.0", "newest", UTC - 10_000_000_000),
        Rejection("north.1", "earlier", UTC - 60_000_000_000),
        Rejection("north.2", "long ago", UTC - 601_000_000_000),
    ]
    rejections.note(letters, 1_000.0, UTC)
    assert (rejections.count(1_000.0), rejections.reason) == (2, "north.0: newest")
    assert rejections.count(1_589.0) == 2
    assert rejections.count(1_590.0) == 0


def test_a_dead_letter_of_a_clock_ahead_is_of_now():
    rejections = Rejections(10.0)
    rejections.note([Rejection("g", "why", UTC + 10**18)], 5.0, UTC)
    assert rejections.count(14.0) == 1
    assert rejections.count(15.0) == 0


@pytest.mark.parametrize(
    "headers",
    [None, [], [("reason", None)], [("reason", b"")], [("size", b"\xff")]],
    ids=["none", "empty", "null", "no text", "another"],
)
def test_a_dead_letter_without_a_reason_is_counted(headers):
    found = Rejection.from_headers(None, headers, 0)
    assert (found.group, found.reason) == ("", "the dead letter names no reason")


def test_names_and_reasons_are_bounded_and_printable():
    headers = [("reason", b"\x1b]0;owned\x07" + b"x" * 10_000), ("topic", b"valvemap.samples")]
    found = Rejection.from_headers(b"\xff\x1b" * 500, headers, 7)
    assert found.group.isprintable()
    assert found.reason.isprintable()
    assert len(found.group) < 200
    assert len(found.reason) < 1_000
    assert found.topic == "valvemap.samples"
