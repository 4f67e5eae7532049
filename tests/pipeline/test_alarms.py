"""Alarms: when they come, go and are acknowledged; the same whatever the cutting."""

from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest

from support.plant import START, as_changes, plant
from valvemap.errors import CommandRejected
from valvemap.model.estimator import StateMismatchError
from valvemap.model.samples import Samples, Segments, Trace
from valvemap.pipeline.alarm_results import Remark
from valvemap.pipeline.alarm_rules import ALARM_NAMES, RULES, Alarm
from valvemap.pipeline.alarm_states import AlarmRule
from valvemap.pipeline.alarm_words import Cause
from valvemap.pipeline.alarms import Alarms
from valvemap.pipeline.operator_ports import Command
from valvemap.pipeline.service_alarms import FLEET_RULES, ServiceAlarms
from valvemap.vocabulary.service_alarms import OF_SERVE, ServiceAlarm
from valvemap.vocabulary.statuses import Quality, Status

S = 1_000_000_000
HZ = 100


def working(n, seed=1, first=0, T=40.0):
    """A valve that works at a few places, and an estimator that knows it: noise is what is left."""
    rng = np.random.default_rng(seed)
    k = first + np.arange(n)
    U, dp = 40.0 + 25.0 * np.sin(k / 300.0), 100.0 + 60.0 * np.sin(k / 170.0)
    p1 = 180.0 + rng.normal(0, 0.05, n)
    Q = 0.12 * U * np.sqrt(dp)
    samples = Samples.of(
        t=START + k * (S // HZ),
        U=U,
        p1=p1,
        p2=p1 - dp + rng.normal(0, 0.05, n),
        Q=Q + rng.normal(0, 0.4, n),
        T=T + rng.normal(0, 0.02, n),
    )
    return samples, said(samples, Q)


def said(samples, predicted, status=Status.OK):
    residual = samples.Q - predicted
    return Trace(predicted, residual, residual, np.full(len(samples), status, np.uint8))


def watch(alarms, samples, trace):
    alarms.watch(samples, trace, Segments.one(len(samples)))


def active(alarms, m=0):
    return [report.name for report in alarms.reports(m) if report.active]


def of(alarms, name, m=0):
    return alarms.reports(m)[ALARM_NAMES.index(name)]


def said_at(second, text=""):
    return Remark(text, "operator", START + second * S)


@pytest.fixture
def known():
    """Alarms of a valve that has worked for five minutes."""
    alarms = Alarms(1, RULES, 200.0)
    watch(alarms, *working(300 * HZ))
    assert active(alarms) == []
    return alarms


def later(seconds, first_s=300, **more):
    return working(int(seconds * HZ), seed=2, first=int(first_s * HZ), **more)


def test_a_valve_that_works_raises_none(known):
    for minute in range(5, 15):
        watch(known, *working(60 * HZ, seed=minute, first=minute * 60 * HZ))
    assert all(report.count == 0 and report.acked for report in known.reports(0))


def test_residuals_larger_than_usual_come_after_the_delay_and_go(known):
    samples, trace = later(30)
    shifted = replace(samples, Q=samples.Q + 1.0)
    watch(known, shifted, said(shifted, trace.predicted))
    report = of(known, "Residual")
    assert (report.active, report.acked, report.count) == (True, False, 1)
    assert START + 300 * S <= report.since <= START + 304 * S
    assert report.at - report.since >= 2 * S
    assert "times their usual size (limit 2.5)" in report.text
    watch(known, *later(30, first_s=330))
    report = of(known, "Residual")
    assert (report.active, report.acked, report.count) == (False, False, 1)


@pytest.mark.parametrize(
    ("moved", "cause"),
    [
        (lambda s, Q: s.Q - 0.05 * Q, Cause.EDGE),  # an edge damaged, or a meter 5 % low ...
        (lambda s, Q: s.Q - 0.05 * Q, Cause.METER),  # ... which is the same
        (lambda s, Q: s.Q + 0.3 * np.sqrt(s.dp), Cause.EDGE),
        (lambda s, Q: s.Q + 3.0, Cause.METER),
        (lambda s, Q: s.Q + 3.0 * Q / s.dp, Cause.SIGNAL),
    ],
)
def test_the_text_names_at_most_three_causes_and_the_true_one_is_among_them(known, moved, cause):
    samples, trace = later(20)
    wrong = replace(samples, Q=moved(samples, trace.predicted))
    watch(known, wrong, said(wrong, trace.predicted))
    text = of(known, "Residual").text
    assert cause.words in text
    assert 1 <= text.split("It may be: ")[1].count(";") + 1 <= 3


def test_oil_that_is_warmer_than_usual_is_named_first(known):
    samples, trace = later(20, T=46.0)
    warm = replace(samples, Q=samples.Q + 1.5)
    watch(known, warm, said(warm, trace.predicted))
    assert f"It may be: {Cause.OIL.words}" in of(known, "Residual").text


def test_residuals_at_places_that_were_never_seen_are_no_alarm(known):
    samples, _ = later(20)
    samples = replace(samples, U=samples.U / 10.0 + 90.0)
    watch(known, samples, said(samples, samples.Q - 30.0))
    assert active(known) == []


def test_a_sensor_that_is_lost_comes_with_time_and_goes_with_the_first_sample(known):
    samples, trace = later(5)
    bad = replace(samples, quality=np.full(len(samples), Quality.BAD, np.uint8))
    watch(known, bad, replace(trace, status=np.full(len(bad), Status.REJECTED, np.uint8)))
    report = of(known, "SensorLost")
    assert (report.active, report.since) == (True, START + 300 * S - S // HZ)
    assert "No usable sample for" in report.text
    watch(known, *later(1, first_s=305))
    assert not of(known, "SensorLost").active
    assert not of(known, "SensorLost").acked


def test_silence_is_a_loss_by_the_clock_too_but_not_where_signals_come_on_change(known):
    known.overdue(np.array([0]), np.array([START + 301 * S]))
    assert active(known) == []
    known.overdue(np.array([0]), np.array([START + 303 * S]))
    assert active(known) == ["SensorLost"]
    patient = Alarms(1, RULES, 200.0)
    patient.be_patient(np.array([0]), np.array([True]))
    watch(patient, *working(HZ))
    watch(patient, *working(HZ, first=100 * HZ))
    assert of(patient, "SensorLost").count == 0


def test_no_transition_of_an_alarm_is_dated_before_the_one_before_it(known):
    """A late sample ends what the clock began, and operators' clocks differ from the source's."""
    known.overdue(np.array([0]), np.array([START + 303 * S]))
    raised = of(known, "SensorLost")
    assert (raised.active, raised.at) == (True, START + 303 * S)
    watch(known, *later(1, first_s=301))
    ended = of(known, "SensorLost")
    assert (ended.active, ended.at) == (False, raised.at)
    assert known.acknowledge(0, Alarm.SENSOR_LOST, said_at(400))
    assert known.states.confirm(0, Alarm.SENSOR_LOST, said_at(350))
    assert of(known, "SensorLost").at == START + 400 * S
    known.overdue(np.array([0]), np.array([START + 310 * S]))
    again = of(known, "SensorLost")
    assert (again.active, again.count, again.at) == (True, 2, START + 400 * S)
    known.acknowledge(0, Alarm.SENSOR_LOST, said_at(500))
    watch(known, *later(1, first_s=501))
    assert of(known, "SensorLost").at == START + 501 * S


def test_after_a_time_away_nothing_counts_as_lost(known):
    known.was_away()
    watch(known, *later(5, first_s=900))
    assert all(report.count == 0 for report in known.reports(0))


@pytest.mark.parametrize("signal", ["p1", "p2", "Q", "T"])
def test_a_sensor_that_stands_still_while_others_move_is_named(known, signal):
    samples, trace = later(15)
    held = {"p2": samples.p2, signal: np.full(len(samples), getattr(samples, signal)[0])}
    watch(known, replace(samples, **held), trace)
    report = of(known, "SensorFrozen")
    assert report.active
    assert report.text.startswith(f"{signal} was constant to the last digit for 1")
    watch(known, *later(2, first_s=315))
    assert not of(known, "SensorFrozen").active


@pytest.mark.parametrize("signal", ["p1", "p2", "Q", "T"])
def test_a_sensor_without_values_is_not_frozen(known, signal):
    samples, trace = later(15)
    watch(known, replace(samples, **{signal: np.full(len(samples), np.nan)}), trace)
    assert of(known, "SensorFrozen").count == 0


def test_a_meter_that_shows_nothing_and_a_command_that_is_held_are_not_frozen(known):
    samples, _ = later(600)
    closed = replace(samples, U=np.zeros(len(samples)), Q=np.zeros(len(samples)))
    watch(known, closed, said(closed, closed.Q, Status.UNEXCITED))
    assert active(known) == []


def test_a_sensor_that_often_stands_still_is_not_frozen_when_it_does():
    alarms = Alarms(1, RULES, 200.0)
    samples, trace = working(1_500 * HZ)
    coarse = replace(samples, T=np.rint(np.arange(len(samples)) / (5.0 * HZ)))  # once in 5 s
    watch(alarms, coarse, trace)
    samples, trace = later(40, first_s=1_500)
    watch(alarms, replace(samples, T=np.full(len(samples), 300.0)), trace)
    assert active(alarms) == []


def test_inputs_that_hold_still_for_longer_than_the_limit_teach_nothing():
    rules = {**RULES, Alarm.UNEXCITED: AlarmRule(60.0, 0.0, 0.0, 100)}
    alarms = Alarms(1, rules, 200.0)
    samples, trace = working(100 * HZ)
    watch(alarms, samples, replace(trace, status=np.full(len(samples), 2, np.uint8)))
    assert active(alarms) == ["Unexcited"]
    watch(alarms, *working(HZ, first=100 * HZ))
    assert active(alarms) == []


def test_a_change_stays_until_it_is_acknowledged_and_the_next_one_comes_anew(known):
    one = np.array([0])
    samples, trace = later(4)
    shifted = replace(samples, Q=samples.Q - 4.0)
    watch(known, shifted, said(shifted, trace.predicted))

    def found(count, size):
        t = np.array([START + 300 * S])
        known.note_changes(one, np.array([count]), t, np.array([size]))

    found(1, -4.0)
    report = of(known, "Changed")
    assert (report.active, report.since) == (True, START + 300 * S)
    assert report.text.startswith("The flow changed by -4 l/min, since 2027-01-15 08:05:00 UTC.")
    found(1, -4.0)
    assert of(known, "Changed").count == 1
    assert known.acknowledge(0, Alarm.CHANGED, said_at(304))
    report = of(known, "Changed")
    assert (report.active, report.acked, report.at) == (False, True, START + 304 * S)
    assert not known.acknowledge(0, Alarm.CHANGED, said_at(302))
    found(1, -4.0)
    assert not of(known, "Changed").active
    found(2, 3.0)
    assert of(known, "Changed").count == 2
    found(0, 0.0)  # a Reset
    assert not of(known, "Changed").active


def test_a_change_that_residuals_do_not_show_is_none(known):
    one, t = np.array([0]), np.array([START + 300 * S])
    watch(known, *later(4))
    known.note_changes(one, np.array([1]), t, np.array([4.0]))
    assert active(known) == []
    new = Alarms(1, RULES, 200.0)  # its map is not settled
    watch(new, *working(10 * HZ))
    new.note_changes(one, np.array([1]), t, np.array([40.0]))
    watch(new, *working(300 * HZ, first=10 * HZ))
    new.note_changes(one, np.array([1]), t, np.array([40.0]))
    assert active(new) == []


def test_lags_losses_misfit_and_guesses_have_their_limits(known):
    one = np.array([0])
    known.note_lags(one, np.array([0.05]))
    known.note_losses(one, np.array([0]), np.array([30_000]))
    assert active(known) == []
    known.note_lags(one, np.array([0.2]))
    watch(known, *later(10))
    known.note_losses(one, np.array([200]), np.array([31_000]))
    assert active(known) == ["SamplesLost", "LagFound"]
    known.note_lags(one, np.array([0.09]))  # within the hysteresis
    assert "LagFound" in active(known)
    known.note_lags(one, np.array([0.05]))
    watch(known, *later(600, first_s=310))
    known.note_losses(one, np.array([200]), np.array([91_000]))
    assert active(known) == []
    for second in (0, 61):
        watch(known, *later(1, first_s=910 + second))
        known.note_misfit(one, np.array([2], np.uint8), np.array([4.0]))
        known.note_answers(one, np.ones(1))
    assert active(known) == ["Misfit", "Extrapolated"]


def test_the_cutting_into_batches_changes_nothing():
    rng = np.random.default_rng(7)
    samples, trace = working(260 * HZ)
    samples.Q[22_000:] += 3.0
    samples.p1[24_000:] = samples.p1[24_000]
    samples.quality[25_000:25_500] = Quality.BAD
    trace = said(samples, trace.predicted)
    whole, cut = Alarms(1, RULES, 200.0), Alarms(1, RULES, 200.0)
    watch(whole, samples, trace)
    ends = [0, *np.sort(rng.integers(0, len(samples), 40)).tolist(), len(samples)]
    for start, stop in pairwise(ends):
        part = Trace(**{f.name: getattr(trace, f.name)[start:stop] for f in fields(Trace)})
        cut.watch(samples[start:stop], part, Segments.one(stop - start))
    assert whole.to_bytes(0) == cut.to_bytes(0)
    assert whole.reports(0) == cut.reports(0)
    assert of(whole, "Residual").count == 1
    assert of(whole, "SensorLost").count == 1


def test_many_valves_are_watched_as_each_alone():
    one, other = Alarms(1, RULES, 200.0), Alarms(3, RULES, 200.0)
    samples, trace = working(240 * HZ)
    samples.Q[22_000:] += 3.0
    trace = said(samples, trace.predicted)
    watch(one, samples, trace)
    segments = Segments(np.array([2]), np.array([0]), np.array([len(samples)]))
    other.watch(samples, trace, segments)
    assert one.to_bytes(0) == other.to_bytes(2)
    assert other.version.tolist()[:2] == [0, 0]


def test_kept_alarms_go_on_and_what_is_no_state_is_refused(known):
    samples, trace = later(20)
    shifted = replace(samples, Q=samples.Q + 3.0)
    watch(known, shifted, said(shifted, trace.predicted))
    kept = known.to_bytes(0)
    other = Alarms(1, {**RULES, Alarm.RESIDUAL: AlarmRule(4.0, 1.0, 2.0, 9)}, 200.0)
    other.from_bytes(0, kept)
    assert of(other, "Residual").active
    assert of(other, "Residual").severity == 9
    assert of(other, "Residual").since == of(known, "Residual").since
    with pytest.raises(StateMismatchError):
        other.from_bytes(0, kept[:-1])
    assert len(kept) < 8_000


def test_nonsense_raises_nothing_and_leaves_all_finite():
    alarms = Alarms(1, RULES, 200.0)
    rng = np.random.default_rng(3)
    for _ in range(50):
        n = 40
        columns = rng.choice([0.0, -1.0, np.nan, np.inf, 1e308, 50.0], (6, n))
        t = START + rng.integers(-5, 5, n) * S
        samples = Samples.of(t, *columns[:5])
        with np.errstate(all="ignore"):
            watch(alarms, samples, said(samples, columns[5]))
    assert len(alarms.reports(0)) == len(Alarm)


def test_the_clock_that_goes_back_raises_nothing(known):
    watch(known, *working(20 * HZ, first=100 * HZ))
    assert active(known) == []


def test_the_service_watches_its_checkpoints_its_certificate_its_load_and_its_history():
    alarms = ServiceAlarms()
    checkpoint, certificate, load, history = OF_SERVE
    alarms.note(START, {checkpoint: 10.0, certificate: -400.0, load: 0.2})
    alarms.note(START + S, {checkpoint: 70.0, certificate: -29.0, load: 0.95})
    assert [r.name for r in alarms.reports() if r.active] == ["Checkpoint", "Certificate"]
    assert "valid for 29 more days (limit 30)" in alarms.reports()[1].text
    alarms.note(START + 40 * S, {checkpoint: 1.0, certificate: np.nan, load: 0.95})
    assert [r.name for r in alarms.reports() if r.active] == ["Certificate", "Load"]
    assert alarms.acknowledge("Load", said_at(41, "busy"))
    alarms.note(START + 41 * S, {history: 12.0})
    assert "The history was not saved for 12.0 s" in alarms.reports()[3].text
    alarms.note(START + 42 * S, {history: 0.0})
    alarms.note(START + 43 * S, {history: np.inf})
    assert alarms.reports()[3].text.startswith("Rows of the history were lost")
    again = ServiceAlarms()
    again.from_bytes(alarms.to_bytes())
    assert again.reports() == alarms.reports()


@pytest.mark.parametrize("name", ["over", "active", "value", "causes", "version"])
def test_alarms_of_the_service_with_arrays_of_another_kind_are_refused(name, monkeypatch):
    alarms, other = ServiceAlarms(), ServiceAlarms()
    alarms.note(START, {ServiceAlarm.CHECKPOINT: 70.0})
    arrays = alarms._states.arrays
    monkeypatch.setattr(
        alarms._states, "arrays", lambda: {**arrays(), name: arrays()[name].astype("<U3")}
    )
    with pytest.raises(StateMismatchError, match=name):
        other.from_bytes(alarms.to_bytes())
    assert other.reports() == ServiceAlarms().reports()


def test_each_service_has_its_own_alarms_and_an_alarm_names_the_newest_reason():
    assert [r.name for r in ServiceAlarms().reports()] == [one.label for one in OF_SERVE]
    alarms = ServiceAlarms(FLEET_RULES)
    rejected = ServiceAlarm.MESSAGES_REJECTED
    alarms.note(START, {rejected: 0.0})
    assert alarms.reports()[-1].text == ""
    for count, reason in enumerate(("north.0: not JSON", "north.1: too large"), 1):
        alarms.give_reason(rejected, reason)
        alarms.note(START + count * S, {rejected: float(count)})
    *others, last = alarms.reports()
    assert not any(one.active for one in others)
    assert (last.name, last.active, last.acked, last.count) == ("MessagesRejected", True, False, 1)
    assert last.text.startswith("2 messages were rejected (north.1: too large), since 2027")
    alarms.note(START + 600 * S, {rejected: 0.0})
    assert not alarms.reports()[-1].active
    assert alarms.acknowledge("MessagesRejected", said_at(601, "seen"))


def test_alarms_are_resumed_after_a_restart_and_acknowledged_by_name(fresh):
    before = fresh()
    before.take(as_changes(plant(500)))
    quiet = before.say_overdue(np.array([0]), np.array([START + 60 * S]))
    assert quiet == [0]
    after = fresh()
    after.restore([*before.states.checkpoints(), *before.states.memories()])
    assert after.alarms("Valvistor") == before.alarms("Valvistor")
    after.do(Command.of("acknowledge", "Valvistor", "SensorLost", said_at(61)))
    assert after.results.one(0) is not None
    (results,) = after.results.of([0])
    assert [r.acked for r in results.alarms.reports(0) if r.active] == [True]
    with pytest.raises(CommandRejected, match="nothing to acknowledge"):
        after.do(Command.of("acknowledge", "Valvistor", "SensorLost", said_at(62)))
    with pytest.raises(CommandRejected, match=r"Service\.Load"):
        after.do(Command.of("acknowledge", None, "Load", said_at(0)))


def test_what_was_acknowledged_is_to_be_confirmed_and_remarks_outlive_a_restart(fresh):
    before = fresh()
    before.take(as_changes(plant(500)))
    assert before.alarmed() == []
    before.say_overdue(np.array([0]), np.array([START + 60 * S]))
    assert before.alarmed() == ["Valvistor"]
    lost = "Valvistor", "SensorLost"
    with pytest.raises(CommandRejected, match="nothing to confirm"):
        before.do(Command.of("confirm", *lost, said_at(61)))
    before.do(Command.of("acknowledge", *lost, said_at(62, "on my way")))
    before.do(Command.of("remark", *lost, said_at(63, "the cable " + 500 * "x")))
    after = fresh()
    after.restore([*before.states.checkpoints(), *before.states.memories()])
    (report,) = (r for r in after.alarms("Valvistor") if r.name == "SensorLost")
    assert (report.active, report.acked, report.confirmed) == (True, True, False)
    assert (report.comment[:10], len(report.comment)) == ("the cable ", 200)
    assert (report.commented_by, report.commented) == ("operator", START + 63 * S)
    after.do(Command.of("confirm", *lost, said_at(64)))
    (report,) = (r for r in after.alarms("Valvistor") if r.name == "SensorLost")
    assert (report.confirmed, report.at, report.comment[:9]) == (True, START + 64 * S, "the cable")
    with pytest.raises(CommandRejected, match="nothing to confirm"):
        after.do(Command.of("confirm", *lost, said_at(65)))
