"""Alarms of the page: those that need somebody, worst first, and events of the time line."""

from dataclasses import replace

from support.shown_service import Alarm
from valvemap.page.alarm_list import AlarmList
from valvemap.page.timeline import TimeLine

S = 1_000_000_000
FIRST = Alarm()
NAMES = ("Changed", "SensorLost", "LagFound")


def heard(*changes, since=0):
    alarms, line = AlarmList(), TimeLine()
    alarms.forget("")
    alarms.hear(changes, line, since)
    return alarms, line


def test_an_alarm_is_there_until_nobody_is_needed():
    cleared = replace(FIRST, active=False, event=b"2")
    done = replace(cleared, acked=True, retain=False, event=b"3")
    assert [row["active"] for row in heard(FIRST)[0].rows()] == [True]
    assert [row["acked"] for row in heard(FIRST, cleared)[0].rows()] == [False]
    assert heard(FIRST, cleared, done)[0].rows() == []


def test_active_ones_come_first_then_the_severest():
    lag = Alarm(name="LagFound", severity=300, event=b"2")
    lost = Alarm(name="SensorLost", severity=800, event=b"3")
    ended = Alarm(source="V2", severity=900, active=False, event=b"4")
    names = [(row["source"], row["name"]) for row in heard(lag, ended, lost)[0].rows()]
    assert names == [("V1", "SensorLost"), ("V1", "LagFound"), ("V2", "Changed")]


def test_an_alarm_is_active_since_it_began_whoever_acknowledged_it_later():
    acked = replace(FIRST, acked=True, event=b"2", t=FIRST.t + 60 * S, begun=FIRST.t)
    assert [row["since"] for row in heard(FIRST, acked)[0].rows()] == [FIRST.t / 1e6]
    seen = replace(acked, active=False, t=FIRST.t + 90 * S)
    assert [row["since"] for row in heard(seen)[0].rows()] == [seen.t / 1e6]


def test_what_was_raised_before_the_page_looked_is_an_alarm_but_no_event():
    alarms, line = heard(FIRST, since=FIRST.t + 1)
    assert len(alarms.rows()) == 1
    assert not line.after(0)


def test_each_change_is_one_event_with_who_did_it():
    acked = replace(FIRST, acked=True, user="anna", event=b"2", t=FIRST.t + S)
    _, line = heard(FIRST, FIRST, acked, since=FIRST.t)
    texts = [event.text for event in line.after(0)]
    assert len(texts) == 2
    assert texts[0].startswith("Changed raised. The flow changed by -4.1 l/min")
    assert texts[1] == "Changed acknowledged by anna; still active."


def test_an_event_names_the_alarm_in_words():
    _, line = heard(Alarm(name="SensorLost", active=False), since=0)
    assert [event.text for event in line.after(0)] == ["Sensor lost cleared; not acknowledged yet."]


def test_an_alarm_of_the_service_is_an_event_of_no_valve():
    _, line = heard(Alarm(source="Service", name="Checkpoint"))
    assert [event.valve for event in line.after(0)] == [""]
