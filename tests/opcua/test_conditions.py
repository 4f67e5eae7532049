"""Alarms as conditions of Part 9: the same logic as the plain tags, one event per change."""

import numpy as np
import pytest
import pytest_asyncio
from asyncua import ua

from support.conditions import CONDITION_TYPE, Listener, event_filter, raised
from support.plant import START
from support.stream import until
from valvemap.pipeline.alarm_rules import Alarm
from valvemap.pipeline.result_ports import Health

pytestmark = pytest.mark.asyncio(loop_scope="module")

Codes, Ids, Op = ua.StatusCodes, ua.ObjectIds, ua.FilterOperator


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def standing():
    async with raised() as plant:
        yield plant


@pytest_asyncio.fixture(loop_scope="module")
async def plant(standing):
    await standing.calm()
    return standing


@pytest_asyncio.fixture(loop_scope="module")
async def listener(plant):
    async with Listener.of(plant) as listener:
        yield listener


async def test_each_change_is_one_event_and_a_life_goes_as_annex_b_says(plant, listener):
    await plant.set_lag(0.3)
    (came,) = await listener.next()
    assert came.state == ("LagFound", True, False, True, True)
    assert came["HighLimit"] == 0.1
    assert came["LimitState/CurrentState/Id"] == ua.NodeId(Ids.ExclusiveLimitStateMachineType_High)
    assert (came["SourceName"], came["Severity"]) == ("Valvistor", 300)
    assert "lags by 0.3 s (limit 0.1 s)" in came["Message"].Text
    assert came.kind == Ids.ExclusiveLimitAlarmType
    assert came.condition.Identifier == "Valvistor.Alarms.LagFound.Condition"
    assert came["BranchId"].is_null()
    assert await listener.act("Acknowledge", came, "seen") == Codes.Good
    (seen,) = await listener.next()
    assert seen.state == ("LagFound", True, True, False, True)
    assert (seen["Comment"].Text, seen["ClientUserId"]) == ("seen", "operator")
    assert came["ActiveState/TransitionTime"] == seen["ActiveState/TransitionTime"] == came["Time"]
    await plant.set_lag(0.05)
    (gone,) = await listener.next()
    assert gone.state == ("LagFound", False, True, False, True)
    assert gone["LimitState/CurrentState/Id"].is_null()
    assert await listener.act("Confirm", came) == Codes.Good  # of the same coming
    (over,) = await listener.next()
    assert over.state == ("LagFound", False, True, True, False)
    assert over["Comment"].Text == "seen"
    assert gone["ActiveState/TransitionTime"] == over["ActiveState/TransitionTime"] == gone["Time"]
    await plant.publish()
    await plant.set_lag(0.3)
    (anew,) = await listener.next()
    assert anew.state == ("LagFound", True, False, True, True)
    assert len({e["EventId"] for e in (came, seen, gone, over, anew)}) == 5
    assert await listener.act("Acknowledge", came) == Codes.BadEventIdUnknown  # of an old one


async def test_an_alarm_of_the_clock_that_a_late_sample_ends_does_not_end_before_it_began(
    plant, listener
):
    await plant.lose_sensors()
    (came,) = await listener.next()
    assert came.state == ("SensorLost", True, False, True, True)
    await plant.take_samples()  # of ten minutes before
    (gone,) = await listener.next()
    assert gone.state == ("SensorLost", False, False, True, True)
    assert gone["Time"] == came["Time"]
    assert gone["EventId"] != came["EventId"]


async def test_what_cannot_be_done_is_refused_with_the_reason(plant, listener):
    await plant.set_lag(0.3)
    (came,) = await listener.next()
    assert await listener.act("Confirm", came) == Codes.BadConditionBranchAlreadyConfirmed
    forged = bytes([*came["EventId"][:-1], came["EventId"][-1] ^ 1])
    for wrong in (b"", b"x" * 32, forged, came["EventId"] + b"\0"):
        assert await listener.act("Acknowledge", came, event_id=wrong) == Codes.BadEventIdUnknown
    assert await listener.act("Acknowledge", came) == Codes.Good
    assert await listener.act("Acknowledge", came) == Codes.BadConditionBranchAlreadyAcked
    null, number = ua.Variant(), ua.Variant(1, ua.VariantType.UInt32)
    acknowledge = ua.NodeId(Ids.AcknowledgeableConditionType_Acknowledge)
    index = await listener.namespace()
    for owner in ("Nothing", "Valvistor", "Valvistor.Alarms.Nothing.Condition"):
        elsewhere = ua.NodeId(owner, index)
        code = await listener.call(elsewhere, acknowledge, null, null)
        assert code == Codes.BadNodeIdUnknown
    assert await listener.call(came.condition, acknowledge, null) == Codes.BadArgumentsMissing
    wrong_type = await listener.call(came.condition, acknowledge, number, null)
    assert wrong_type == Codes.BadInvalidArgument
    enable = ua.NodeId(Ids.ConditionType_Enable)
    assert await listener.call(came.condition, enable) == Codes.BadMethodInvalid
    async with Listener.of(plant, user=None) as observer:
        assert await observer.act("AddComment", came, "hello") == Codes.BadUserAccessDenied


async def test_a_comment_is_an_event_and_plain_tags_and_conditions_say_the_same(plant, listener):
    await plant.set_lag(0.3)
    (came,) = await listener.next()
    plant.clock.advance(1.0)
    assert await listener.act("AddComment", came, "the filter's") == Codes.Good
    (said,) = await listener.next()
    assert (said["Comment"].Text, said.state) == ("the filter's", came.state)
    assert said["EventId"] != came["EventId"]
    index = await listener.namespace()
    lag = listener.client.get_node(ua.NodeId("Valvistor.Alarms.LagFound", index))
    comment = ua.Variant("seen there", ua.VariantType.String)
    await lag.call_method(f"{index}:Acknowledge", comment)
    (seen,) = await listener.next()
    assert seen.state == ("LagFound", True, True, False, True)
    assert await (await lag.get_child(f"{index}:Acked")).read_value()
    assert not await (await lag.get_child(f"{index}:Confirmed")).read_value()
    assert await listener.act("Confirm", seen) == Codes.Good
    assert await (await lag.get_child(f"{index}:Confirmed")).read_value()
    action = listener.client.get_node(ua.NodeId("Valvistor.Diagnostics.LastAction", index))
    assert await action.read_value() == "operator: Alarms.LagFound Confirm ''"


async def test_a_refresh_shows_what_is_retained_and_nothing_else(plant, listener):
    assert await listener.refreshed() == []
    await plant.set_lag(0.3)
    await plant.lose_sensors()
    came = await listener.next(2)
    assert [e.state for e in await listener.refreshed()] == [e.state for e in came[::-1]]
    await plant.set_lag(0.0)
    await listener.next()
    again = await listener.refreshed()
    assert {e["EventId"] for e in again} - {e["EventId"] for e in came}
    assert await listener.refresh(listener.item) == Codes.Good
    start, *_, end = await listener.next(4)
    assert (start.kind, end.kind) == (Ids.RefreshStartEventType, Ids.RefreshEndEventType)
    assert await listener.refresh(listener.item + 1) == Codes.BadMonitoredItemIdInvalid
    async with Listener.of(plant) as other:
        other.subscription, mine = listener.subscription, other.subscription
        assert await other.refresh() == Codes.BadUserAccessDenied
        other.subscription = 10_000
        assert await other.refresh() == Codes.BadSubscriptionIdInvalid
        other.subscription = mine
        assert [e["EventId"] for e in await other.refreshed()] == [e["EventId"] for e in again]


async def test_a_refresh_is_heard_whatever_the_filter_says(plant):
    severity = ua.SimpleAttributeOperand(
        ua.NodeId(Ids.BaseEventType), [ua.QualifiedName("Severity")], ua.AttributeIds.Value
    )
    urgent = event_filter((Op.GreaterThan, severity, ua.LiteralOperand(ua.Variant(500))))
    async with Listener.of(plant, filter_=urgent) as urgent:
        await plant.set_lag(0.3)
        await plant.lose_sensors()
        (came,) = await urgent.next()
        assert came["ConditionName"] == "SensorLost"
        assert [e["ConditionName"] for e in await urgent.refreshed()] == ["SensorLost"]


async def test_a_refresh_of_more_than_the_queue_holds_loses_nothing(plant):
    async with Listener.of(plant, queue=1) as narrow:
        await plant.set_lag(0.3)
        await narrow.next()
        await plant.lose_sensors()
        await narrow.next()
        assert [e["ConditionName"] for e in await narrow.refreshed()] == ["SensorLost", "LagFound"]


async def test_who_misses_events_hears_that_some_were_lost(plant):
    async with Listener.of(plant, queue=2) as narrow:
        for lag in (0.3, 0.0) * 10:  # faster than the publishing interval
            await plant.set_lag(lag)
        events = await narrow.next(3)
        assert events[0].kind == Ids.EventQueueOverflowEventType
        assert [e.state[1] for e in events[1:]] == [True, False]


async def test_a_valves_subscribers_hear_of_that_valve(plant):
    async with Listener.of(plant) as listener:
        index = await listener.namespace()
        for name in ("Identification", "Valvistor"):
            async with Listener.of(plant, node=ua.NodeId(name, index)) as own:
                await plant.set_lag(0.3)
                assert (await own.next())[0]["ConditionName"] == "LagFound"
                await plant.set_lag(0.0)
        with pytest.raises(ua.uaerrors.BadNotSupported):
            async with Listener.of(plant, node=ua.NodeId("Valvistor.Alarms", index)):
                pass


async def test_after_a_restart_it_goes_on_where_it_was_under_the_same_event_id(plant):
    async with Listener.of(plant) as listener:
        await plant.set_lag(0.3)
        (came,) = await listener.next()
        await listener.act("Acknowledge", came, "seen")
        (seen,) = await listener.next()
    await plant.restart()
    async with Listener.of(plant) as listener:
        again = await listener.refreshed()
        assert again == [seen]
        assert await listener.act("Confirm", seen) == Codes.Good
        (over,) = await listener.next()
        assert over.state == ("LagFound", True, True, True, True)
    assert plant.report("LagFound").confirmed


async def test_a_condition_is_an_object_of_its_type_and_its_variables_follow(plant, listener):
    index = await listener.namespace()
    await plant.set_lag(0.3)
    (came,) = await listener.next()
    valve = listener.client.get_node(ua.NodeId("Valvistor", index))
    conditions = await valve.get_referenced_nodes(Ids.HasCondition)
    assert came.condition in [node.nodeid for node in conditions]
    assert len(conditions) == len(Alarm)
    condition = listener.client.get_node(came.condition)
    assert await condition.read_type_definition() == ua.NodeId(Ids.ExclusiveLimitAlarmType)
    names = {(await child.read_browse_name()).Name for child in await condition.get_children()}
    kind, mandatory = listener.client.get_node(await condition.read_type_definition()), set()
    while kind.nodeid != ua.NodeId(Ids.BaseObjectType):
        for child in await kind.get_children(refs=Ids.Aggregates):
            rules = await child.get_referenced_nodes(Ids.HasModellingRule)
            if ua.NodeId(Ids.ModellingRule_Mandatory) in [rule.nodeid for rule in rules]:
                mandatory.add((await child.read_browse_name()).Name)
        kind = await kind.get_parent()
    assert mandatory - names == {"Enable", "Disable"}

    async def read(*path):
        child = await condition.get_child([f"0:{name}" for name in path])
        return await child.read_value()

    assert await read("EventId") == came["EventId"]
    assert await read("LimitState", "CurrentState", "Id") == came["LimitState/CurrentState/Id"]
    assert (await read("ActiveState", "Id"), await read("AckedState", "Id")) == (True, False)
    assert await listener.act("Acknowledge", came, "seen") == Codes.Good
    assert (await read("AckedState", "Id"), (await read("Comment")).Text) == (True, "seen")
    assert await read("ClientUserId") == "operator"
    await condition.call_method("0:Confirm", came["EventId"], ua.LocalizedText(""))
    assert await read("Retain") is True  # still active
    await plant.set_lag(0.0)
    assert await read("Retain") is False


async def test_the_services_own_alarms_are_conditions_too(plant, listener):
    plant.live.watch_service(START, 10.0, 20.0, 0.1)
    index = await listener.namespace()
    alarms = plant.live.alarms(None)
    await plant.server.show_health(Health(np.zeros(1), np.zeros(1, np.int64), alarms=alarms))
    (came,) = await listener.next()
    assert came.state == ("Certificate", True, False, True, True)
    assert (came["SourceName"], came["HighLimit"]) == ("Service", None)
    assert came["ConditionClassId"] == ua.NodeId(Ids.SystemConditionClassType)
    assert await listener.act("Acknowledge", came) == Codes.Good
    assert came.condition == ua.NodeId("Service.Alarms.Certificate.Condition", index)


async def test_asyncuas_own_way_to_subscribe_to_alarms_works(plant, listener):
    heard = []

    class Handler:
        def event_notification(self, event):
            heard.append(event)

    subscription = await listener.client.create_subscription(50, Handler())
    kinds = [ua.NodeId(Ids.ExclusiveLimitAlarmType)]
    await subscription.subscribe_alarms_and_conditions(
        ua.NodeId(Ids.Server), [listener.client.get_node(kind) for kind in kinds]
    )
    await plant.set_lag(0.3)
    await listener.next()
    await until(lambda: heard)
    assert heard[0].ConditionName == "LagFound"
    assert heard[0].NodeId.Identifier == "Valvistor.Alarms.LagFound.Condition"
    await listener.client.get_node(CONDITION_TYPE).call_method(
        "0:ConditionRefresh", ua.Variant(subscription.subscription_id, ua.VariantType.UInt32)
    )
