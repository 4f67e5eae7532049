"""What came and went with another configuration: NodeVersion, and the event that says so."""

from contextlib import asynccontextmanager
from dataclasses import replace

import numpy as np
import pytest
from asyncua import ua

from guarded_opcua import Role, UserStore
from support import node_peer
from support.clocks import TurnedClock
from support.peer import Peer
from support.results import ESTIMATOR, INVERSE, results_of, results_settings
from support.served import patient
from support.stream import until
from support.users import CHEAP
from valvemap.opcua_results.companions import DI
from valvemap.opcua_results.model_changes import model_change, version_of_root, version_of_valve
from valvemap.opcua_results.results_server import NAMESPACE, ResultsServer
from valvemap.pipeline.nameplate import Nameplate
from valvemap.pipeline.results import EstimatorDescription, ValveDescription

T = 1_800_000_000_000_000_000
RLS = EstimatorDescription("RLS", "Least squares.", ("a1",), has_forgetting_factor=True)
RBF = replace(RLS, name="RBF")
BOOM, BUCKET, STICK = (ValveDescription(name, (RLS,)) for name in ("Boom", "Bucket", "Stick"))
WITH_RBF = replace(BOOM, estimators=(RLS, RBF))
KIND = ua.NodeId(ua.ObjectIds.GeneralModelChangeEventType)
ADDED, DELETED, REFERENCE_ADDED, REFERENCE_DELETED = 1, 2, 4, 8
FIELDS = "EventType", "SourceNode", "Time", "Message", "Changes"


def changes(before, after):
    event = model_change(before, after, 1, ua.NodeId("Types.Valve", 1), T)
    if event is None:
        return None
    return {one.Affected.Identifier: one.Verb for one in event.fields["Changes"].Value}


class Operator:
    """As much of one as nodes need."""

    def do(self, command):
        return getattr(self, command.action)(*command.arguments)

    def alarms(self, valve):
        return ()

    def __getattr__(self, name):
        return lambda *_: None


@asynccontextmanager
async def served(valves, before=None, clock=None):
    settings = results_settings(none_on_loopback=True)
    clock = clock or TurnedClock(T)
    async with ResultsServer(settings, valves, Operator(), clock, before=before) as server:
        yield server


async def version_of(server, id_):
    async with patient(server.url) as client:
        index = await client.get_namespace_index(NAMESPACE)
        node = client.get_node(ua.NodeId(id_, index))
        return await (await node.get_child("0:NodeVersion")).read_value()


async def heard(client, node):
    """The events of model changes that an item hears which begins to listen."""
    events = []

    class Handler:
        def event_notification(self, event):
            events.append(event)

    subscription = await client.create_subscription(50, Handler())
    await subscription.subscribe_events(node, client.get_node(KIND))
    return events


def test_a_valve_that_can_be_driven_is_another_model():
    driven = replace(BOOM, is_driven=True)
    assert version_of_valve(driven) != version_of_valve(BOOM)
    assert changes([BOOM], [driven]) == {"Boom": ADDED | DELETED}


def test_what_came_and_went_is_said_of_the_valve_and_of_what_it_is_below():
    both = REFERENCE_ADDED | REFERENCE_DELETED
    assert changes([BOOM, BUCKET], [BOOM, STICK]) == {
        "Stick": ADDED,
        "Bucket": DELETED,
        "Identification": both,
    }
    assert changes([BOOM], [BOOM, STICK])["Identification"] == REFERENCE_ADDED


def test_a_valve_that_is_described_otherwise_is_made_anew():
    assert changes([BOOM], [WITH_RBF]) == {"Boom": ADDED | DELETED}
    plate = replace(BOOM, nameplate=Nameplate(serial_number="1"))
    assert changes([BOOM], [plate]) == {"Boom": ADDED | DELETED}


def test_where_no_node_came_or_went_nothing_is_said():
    assert changes([BOOM, STICK], [STICK, BOOM]) is None


def test_a_version_depends_on_what_there_is_alone():
    assert version_of_root([BOOM, STICK]) == version_of_root([STICK, BOOM])
    assert version_of_root([BOOM]) != version_of_root([BOOM, STICK])
    assert version_of_root([BOOM]) != version_of_root([WITH_RBF])
    assert version_of_valve(BOOM) != version_of_valve(WITH_RBF)


def test_a_thousand_valves_are_named_in_the_changes_and_a_few_in_the_message():
    valves = [replace(BOOM, name=f"V{k}") for k in range(1_000)]
    event = model_change([], valves, 1, ua.NodeId("Types.Valve", 1), T)
    assert len(event.fields["Changes"].Value) == 1_001
    assert len(event.fields["Message"].Value.Text) < 100


async def test_versions_stand_where_children_come_and_go():
    async with served([BOOM, STICK]) as server:
        assert await version_of(server, "Identification") == version_of_root([BOOM, STICK])
        assert await version_of(server, "Boom") == version_of_valve(BOOM)


async def test_who_comes_back_is_told_once_and_after_ten_minutes_nobody_is():
    clock = TurnedClock(T)
    async with served([BOOM, STICK], before=[BOOM, BUCKET], clock=clock) as server:
        async with patient(server.url) as client:
            events = await heard(client, client.nodes.server)
            await until(lambda: events)
            (event,) = events
            assert event.EventType == KIND
            assert event.SourceNode == ua.NodeId(ua.ObjectIds.Server)
            assert "added: Stick; removed: Bucket" in event.Message.Text
            verbs = {one.Affected.Identifier: one.Verb for one in event.Changes}
            assert (verbs["Stick"], verbs["Bucket"]) == (ADDED, DELETED)
            at = await client.get_namespace_index(NAMESPACE)
            below = await heard(client, client.get_node(ua.NodeId("Identification", at)))
            await until(lambda: below)
            assert len(events) == 1
        clock.advance(600.0)
        async with patient(server.url) as client:
            late = await heard(client, client.nodes.server)
            await client.nodes.server_state.read_value()
            assert not late


async def test_the_first_server_tells_nothing():
    async with served([BOOM]) as server, patient(server.url) as client:
        events = await heard(client, client.nodes.server)
        await client.nodes.server_state.read_value()
        assert not events
        assert not server._server._subscriptions.events._standing


@pytest.mark.node
async def test_node_opcua_hears_what_came_and_went(request):
    program = node_peer.program(request.config.cache.mkdir("node_peer"), "client.cjs")
    peer = await Peer.start(*program)
    try:
        async with served([BOOM, STICK], before=[BOOM, BUCKET]) as server:
            await peer.ask("connect", url=server.url, **{"as": "main"})
            asked = {"fields": FIELDS, "kind": "GeneralModelChangeEventType", "as": "main"}
            await peer.ask("listen", node="i=2253", **asked)
            told = []
            while not told:
                told += await peer.ask("events", **{"as": "main"})
            (event,) = told
            assert event["EventType"] == "ns=0;i=2133"
            verbs = {one["affected"].rpartition("=")[2]: one["verb"] for one in event["Changes"]}
            assert (verbs["Stick"], verbs["Bucket"]) == (ADDED, DELETED)
            await peer.ask("disconnect", **{"as": "main"})
    finally:
        await peer.stop()


def result(number, predicted):
    """A result of the valve that the operator numbers so."""
    rls = replace(ESTIMATOR, theta=np.array([1.0]), std=np.array([0.1]), predicted=predicted)
    return results_of(number, {"RLS": rls}, INVERSE)


async def made_up(client, valves):
    """Nodes of the predicted flow of valves."""
    at = await client.get_namespace_index(NAMESPACE)
    return [client.get_node(ua.NodeId(f"{v}.RLS.PredictedFlow", at)) for v in valves]


class Seen:
    """What a subscription of data changes was sent, by valve."""

    def __init__(self):
        self.values = {}

    def datachange_notification(self, node, value, data):
        valve = node.nodeid.Identifier.partition(".")[0]
        self.values.setdefault(valve, []).append(data.monitored_item.Value)

    def last(self, valve):
        if valve not in self.values:
            return None
        held = self.values[valve][-1]
        return None if held.Value is None else held.Value.Value, held.StatusCode.value


async def test_sessions_and_items_of_valves_left_alone_outlive_another_configuration():
    async with served([BOOM, BUCKET]) as server, patient(server.url) as client:
        events = await heard(client, client.nodes.server)
        for number, predicted in enumerate((10.0, 20.0)):
            await server.publish(result(number, predicted))
        seen = Seen()
        subscription = await client.create_subscription(50, seen)
        await subscription.subscribe_data_change(await made_up(client, ("Boom", "Bucket")))
        await until(lambda: len(seen.values) == 2)
        version = await version_of(server, "Identification")
        await server.follow([STICK, BOOM], Operator())
        for number, predicted in enumerate((30.0, 11.0)):
            await server.publish(result(number, predicted))
        await until(lambda: events and seen.last("Boom") == (11.0, ua.StatusCodes.Good))
        await until(lambda: seen.last("Bucket") == (None, ua.StatusCodes.BadNodeIdUnknown))
        (event,) = events
        verbs = {one.Affected.Identifier: one.Verb for one in event.Changes}
        assert (verbs["Stick"], verbs["Bucket"]) == (ADDED, DELETED)
        assert await version_of(server, "Identification") != version
        bucket, stick = await made_up(client, ("Bucket", "Stick"))
        with pytest.raises(ua.uaerrors.BadNodeIdUnknown):
            await bucket.read_value()
        assert await stick.read_value() == 30.0
        await subscription.subscribe_data_change(stick)
        await server.publish(result(0, 31.0))
        await until(lambda: seen.last("Stick") == (31.0, ua.StatusCodes.Good))
        at, di = [await client.get_namespace_index(uri) for uri in (NAMESPACE, DI)]
        root = client.get_node(ua.NodeId("Identification", at))
        devices = await client.nodes.objects.get_child(f"{di}:DeviceSet")
        for folder in (root, devices):
            names = {one.nodeid.Identifier for one in await folder.get_children()}
            assert names & {"Boom", "Bucket", "Stick"} == {"Boom", "Stick"}
        await subscription.delete()


async def test_a_valve_that_comes_back_is_another_one():
    async with served([BOOM, BUCKET]) as server, patient(server.url) as client:
        await server.publish(result(1, 20.0))
        (bucket,) = await made_up(client, ["Bucket"])
        assert await bucket.read_value() == 20.0
        await server.follow([BOOM], Operator())
        await server.follow([replace(BUCKET, estimators=(RLS, RBF)), BOOM], Operator())
        held = await bucket.read_data_value(raise_on_bad_status=False)
        assert held.StatusCode.value == ua.StatusCodes.BadWaitingForInitialData
        await server.publish(result(1, 12.0))  # Boom
        assert await (await made_up(client, ["Boom"]))[0].read_value() == 12.0
        held = await bucket.read_data_value(raise_on_bad_status=False)
        assert held.StatusCode.value == ua.StatusCodes.BadWaitingForInitialData


async def test_commands_go_to_who_is_in_charge_and_to_nobody_in_between():
    users, password = UserStore.one_time("operator", Role.OPERATOR, CHEAP)
    asked = []

    class Named(Operator):
        def __init__(self, name):
            self.name = name

        def reset(self, valve, estimator):
            asked.append((self.name, valve, estimator))

    settings = results_settings(none_on_loopback=True, users=users)
    async with ResultsServer(settings, [BOOM], Named("old"), TurnedClock(T)) as server:
        client = patient(server.url)
        client.set_user("operator")
        client.set_password(password)
        async with client:
            at = await client.get_namespace_index(NAMESPACE)
            owner = client.get_node(ua.NodeId("Boom.RLS", at))
            method = ua.NodeId("Boom.RLS.Reset", at)
            await owner.call_method(method)
            server.take_no_commands()
            with pytest.raises(ua.uaerrors.BadInvalidState):
                await owner.call_method(method)
            await server.follow([BUCKET, BOOM], Named("new"))
            await owner.call_method(method)
    assert asked == [("old", "Boom", "RLS"), ("new", "Boom", "RLS")]


async def test_a_standing_demand_is_asked_of_the_new_operator():
    users, password = UserStore.one_time("operator", Role.OPERATOR, CHEAP)
    demands = []

    class Asked(Operator):
        def demand(self, valve, Q, dp):
            demands.append((valve, Q, dp))

    settings = results_settings(none_on_loopback=True, users=users)
    async with ResultsServer(settings, [BOOM], Operator(), TurnedClock(T)) as server:
        client = patient(server.url)
        client.set_user("operator")
        client.set_password(password)
        async with client:
            at = await client.get_namespace_index(NAMESPACE)
            demand = client.get_node(ua.NodeId("Boom.Inverse.FlowDemand", at))
            await demand.write_value(ua.DataValue(ua.Variant(50.0)))
            await server.follow([BUCKET, BOOM], Asked())
    ((valve, Q, _),) = demands
    assert (valve, Q) == ("Boom", 50.0)


async def test_axes_that_come_and_go_are_said_and_versioned():
    async with served([BOOM]) as server, patient(server.url) as client:
        await server.follow_axes(["Press"], None)
        assert await version_of(server, "Identification") == version_of_root([BOOM], ["Press"])
        events = await heard(client, client.nodes.server)
        await server.follow_axes(["Press"], None)
        await server.follow_axes([], None)
        assert await version_of(server, "Identification") == version_of_root([BOOM])
        await server.follow_axes(["Lift"], None)
        await until(lambda: len(events) == 2)
    said = [event.Message.Text for event in events]
    assert said == ["Axes removed: Press", "Axes added: Lift"]
