"""The alarms of an axis follow its findings, its silence and its failure; operators act on them."""

from dataclasses import fields, make_dataclass, replace
from typing import Any

import pytest

from valvemap.errors import CommandRejected
from valvemap.model.axis_condition import CAUSES
from valvemap.model.estimator import State, StateMismatchError
from valvemap.pipeline.alarm_results import Remark
from valvemap.pipeline.axis_alarms import ALARM_OF, AXIS_RULES, AxisAlarms
from valvemap.pipeline.axis_ports import AxisResults, RequiredU
from valvemap.pipeline.operator_ports import Command
from valvemap.pipeline.quantity_alarms import KeptAlarms
from valvemap.vocabulary.axis_alarms import AxisAlarm
from valvemap.vocabulary.findings import Finding, FindingCode
from valvemap.vocabulary.statuses import AxisStatus

T = 1_800_000_000_000_000_000
HEALTHY = AxisResults(AxisStatus.OK, "", T, 100.0, {}, None, RequiredU(), ())
WORN = Finding(FindingCode.BT_CHANGE, 0.97, "The edge BT passes 9 ± 1 % less than before.")
LESS = Finding(FindingCode.PA_CHANGE, 0.03, "The edge PA passes 1 % less than before.")


def seen(alarms, *findings, silent_s=0.0, **more):
    alarms.judge(replace(HEALTHY, findings=findings, **more), T, silent_s)
    return {one.name: one for one in alarms.reports() if one.active}


def acted(action):
    return Command(action, "Press", "EdgeChanged", remark=Remark("mended", "operator", T))


def test_every_cause_has_an_alarm_and_every_alarm_a_rule():
    assert ALARM_OF.keys() == set(CAUSES)
    assert AXIS_RULES.keys() == set(AxisAlarm)


@pytest.mark.parametrize("code", CAUSES)
def test_a_certain_finding_raises_its_alarm_with_its_cause_and_the_repair_ends_it(code):
    alarms = AxisAlarms()
    finding = Finding(code, 0.9, "Something passes less.")
    active = seen(alarms, finding)
    assert list(active) == [ALARM_OF[code].label]
    assert "Something passes less. Found with a probability of up to 0.90" in str(active)
    assert seen(alarms, replace(finding, probability=0.6)) != {}
    assert seen(alarms) == {}


def test_an_unsure_finding_raises_none_and_the_likeliest_edge_is_named():
    alarms = AxisAlarms()
    assert seen(alarms, LESS) == {}
    assert seen(alarms, LESS, WORN)["EdgeChanged"].text.startswith(WORN.sentence)


def test_silence_and_an_error_are_alarms():
    alarms = AxisAlarms()
    failed = {"status": AxisStatus.FAILED, "sentence": "(ValueError)"}
    active = seen(alarms, silent_s=3.0, **failed)
    assert set(active) == {"AxisSilent", "AxisFailed"}
    assert "ValueError" in active["AxisFailed"].text
    assert set(seen(alarms)) == set()


def test_operators_acknowledge_confirm_and_comment():
    alarms = AxisAlarms()
    with pytest.raises(CommandRejected, match="nothing to acknowledge"):
        alarms.act(acted("acknowledge"))
    seen(alarms, WORN)
    for action in ("acknowledge", "confirm", "remark"):
        alarms.act(acted(action))
    report = alarms.reports()[0]
    assert (report.acked, report.confirmed, report.comment) == (True, True, "mended")
    with pytest.raises(CommandRejected, match="no command of an alarm"):
        alarms.act(acted("reset"))


@pytest.mark.parametrize("first", ["the alarm ends", "it is acknowledged"])
def test_the_end_of_an_alarm_stays_known_whatever_is_done_to_it_later(first):
    alarms = AxisAlarms()
    for turn in range(2):
        came = T + 10_000 * turn
        alarms.judge(replace(HEALTHY, t=came, findings=(WORN,)), came, 0.0)
        assert ended(alarms) == 0
        order = ["end", "acknowledge", "confirm"]
        for action in order if first == "the alarm ends" else [order[1], order[0], order[2]]:
            if action == "end":
                alarms.judge(replace(HEALTHY, t=came + 500), came + 500, 0.0)
            else:
                said = Remark("seen", "operator", came + 400 + 1_000 * (action == "confirm"))
                alarms.act(Command(action, "Press", "EdgeChanged", remark=said))
        assert ended(alarms) == came + 500
        again = AxisAlarms()
        again.from_bytes(alarms.to_bytes())
        assert ended(again) == came + 500


def ended(alarms):
    return alarms.reports()[0].ended


def test_alarms_that_a_version_before_has_stored_ended_at_their_last_action_at_the_latest():
    alarms, again = AxisAlarms(), AxisAlarms()
    seen(alarms, WORN)
    alarms.act(acted("acknowledge"))
    seen(alarms)
    kept = KeptAlarms.from_bytes(alarms.to_bytes("key"), f"{alarms._key}key")
    names = [field.name for field in fields(KeptAlarms) if field.name != "ended"]
    old = make_dataclass("KeptAlarms", [(name, Any) for name in names], bases=(State,), frozen=True)
    packed = old(**{name: getattr(kept, name) for name in names})
    again.from_bytes(packed.to_bytes(f"{alarms._key}key"), "key")
    assert ended(again) == ended(alarms) == T


def test_alarms_survive_a_restart_but_not_another_axis():
    alarms, again = AxisAlarms(), AxisAlarms()
    seen(alarms, WORN)
    again.from_bytes(alarms.to_bytes("key"), "key")
    assert [one.active for one in again.reports()] == [one.active for one in alarms.reports()]
    with pytest.raises(StateMismatchError):
        again.from_bytes(alarms.to_bytes("key"), "other")
