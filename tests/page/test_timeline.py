"""What is an event, and what only flickers."""

from valvemap.page.judgement import Reason, Severity, Standing, judge
from valvemap.page.timeline import TimeLine

S = 1_000_000_000


def texts(line):
    return [(event.t // S, event.kind, event.text) for event in line.after(0)]


def test_a_state_that_lasts_is_an_event_from_its_beginning_on():
    line = TimeLine()
    line.stands("V1", Reason.OK, 0)
    for t in (1, 2, 3):
        line.stands("V1", Reason.UNEXCITED, t * S)
    assert texts(line) == [(1, "status", Reason.UNEXCITED.sentence)]


def test_a_state_that_flickers_is_none():
    line = TimeLine()
    for t in range(20):
        reason, since = line.stands("V1", (Reason.OK, Reason.UNEXCITED)[t % 2], t * S)
    assert (texts(line), reason, since) == ([], Reason.OK, 0)


def test_what_was_before_the_page_looked_is_no_event():
    line = TimeLine()
    line.changed("V1", "RLS", 3, 5 * S, -2.0)
    line.acted("V1", "operator: Freeze RLS", 6 * S)
    assert texts(line) == []
    line.changed("V1", "RLS", 4, 7 * S, -3.25)
    line.acted("V1", "operator: Resume RLS", 8 * S)
    assert texts(line) == [
        (7, "change", "RLS found an abrupt change: −3.2 l/min."),
        (8, "action", "operator: Resume RLS"),
    ]


def test_only_the_newest_thousand_are_kept():
    line = TimeLine()
    for t in range(1_500):
        line.add(t, "V1", "link", Severity.NOTE, "")
    assert len(line.after(0)) == 1_000
    assert [event.number for event in line.after(1_498)] == [1_499, 1_500]


def test_the_worst_that_there_is_to_say_is_said():
    assert judge(Standing(code=0x80320000, status=1, silent_s=99.0)) is Reason.WARMING_UP
    assert judge(Standing(code=0, status=0, silent_s=0.0, changed_s=30.0)) is Reason.CHANGED
    assert judge(Standing(code=0x808C0000, status=3, silent_s=0.0)) is Reason.SENSOR_FAILURE
    assert judge(Standing(code=0x40000000, status=2, silent_s=0.0, adaptation=2)) is Reason.MISFIT
    assert judge(Standing(code=0x80310000, status=0, silent_s=9.0)) is Reason.NO_SAMPLES


def test_an_alarm_makes_a_valve_worse_than_its_estimator_says():
    failed = judge(Standing(code=0, status=0, silent_s=0.1, health=1))
    assert (failed, failed.severity) == (Reason.FAULTY, Severity.ALARM)
    assert judge(Standing(code=0, status=0, silent_s=0.1, health=4)).severity == Severity.WARNING
    assert judge(Standing(code=0, status=0, silent_s=60.0, health=4)) is Reason.STALE
