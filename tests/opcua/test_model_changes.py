"""What came and went with another configuration: NodeVersion, and the event that says so."""

from contextlib import asynccontextmanager
from dataclasses import replace

import pytest
from asyncua import Client, ua
from support import node_peer
from support.clocks import TurnedClock
from support.conditions import until
from support.peer import Peer
from support.results import results_settings

from service.opcua.model_changes import model_change, version_of_root, version_of_valve
from service.opcua.results_server import NAMESPACE, ResultsServer
from service.streaming.nameplate import Nameplate
from service.streaming.ports import EstimatorDescription, ValveDescription

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
    async with Client(server.url) as client:
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


def test_what_came_and_went_is_said_of_the_valve_and_of_what_it_is_below():
    both = REFERENCE_ADDED | REFERENCE_DELETED
    assert changes([BOOM, BUCKET], [BOOM, STICK]) == {
        "Stick": ADDED,
        "Bucket": DELETED,
        "Identification": both,
    }
    assert changes([BOOM], [BOOM, STICK])["Identification"] == REFERENCE_ADDED


def test_what_changed_below_a_valve_is_said_of_the_valve():
    assert changes([BOOM], [WITH_RBF]) == {"Boom": REFERENCE_ADDED | REFERENCE_DELETED}
    plate = replace(BOOM, nameplate=Nameplate(serial_number="1"))
    assert changes([BOOM], [plate]) == {"Boom": REFERENCE_ADDED | REFERENCE_DELETED}


def test_where_no_node_came_or_went_nothing_is_said():
    assert changes([BOOM, STICK], [STICK, BOOM]) is None
    one, other = (replace(BOOM, nameplate=Nameplate(serial_number=n)) for n in "12")
    assert changes([one], [other]) is None


def test_a_version_depends_on_what_there_is_alone():
    assert version_of_root([BOOM, STICK]) == version_of_root([STICK, WITH_RBF])
    assert version_of_root([BOOM]) != version_of_root([BOOM, STICK])
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
        async with Client(server.url) as client:
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
        async with Client(server.url) as client:
            late = await heard(client, client.nodes.server)
            await client.nodes.server_state.read_value()
            assert not late


async def test_the_first_server_tells_nothing():
    async with served([BOOM]) as server, Client(server.url) as client:
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
