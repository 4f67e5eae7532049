"""Behaviour by the standard, seen through asyncua's plain client over a real socket."""

# ruff: noqa: FBT003 - positional fields of OPC UA structures

import asyncio
import contextlib
import time

import pytest
import pytest_asyncio
from asyncua import Client, ua

from guarded_opcua import (
    HardenedServer,
    Limits,
    Role,
    ServerSettings,
    Unit,
    UserStore,
    add_object,
    add_variable,
)
from support.proxy import Proxy
from support.raw_peer import RawPeer
from support.served import patient
from support.users import CHEAP

pytestmark = pytest.mark.asyncio(loop_scope="module")

Codes = ua.StatusCodes
PASSWORD = "correct horse"
T0 = 1_800_000_000_000_000_000
EVERY = ua.DataChangeFilter(Trigger=ua.DataChangeTrigger.StatusValueTimestamp)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def server():
    users = UserStore(cost=CHEAP)
    users.add("oskar", Role.OPERATOR, PASSWORD)
    users.add("erna", Role.ENGINEER, PASSWORD)
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/services/",
        application_uri="urn:test:services",
        application_name="services",
        namespace_uri="urn:services",
        users=users,
        none_on_loopback=True,
        limits=Limits(continuation_points=2),
    )
    made = await HardenedServer.create(settings)
    folder = await add_object(made, None, "Plant")
    made.folder = folder
    made.flow = await add_variable(
        made, folder, "Plant.Flow", 0.0, unit=Unit.LITRE_PER_MINUTE, value_range=(0.0, 200.0)
    )
    made.table = await add_variable(made, folder, "Plant.Table", [1.0, 2.0, 3.0], dimensions=(3,))
    made.count = await add_variable(made, folder, "Plant.Count", 0, type=ua.VariantType.UInt32)
    made.mode = await add_variable(
        made, folder, "Plant.Mode", 1, type=ua.VariantType.Int32, enum_strings=("Off", "On")
    )
    made.empty = await add_variable(made, folder, "Plant.Empty", None)
    async with made:
        yield made


@pytest_asyncio.fixture(loop_scope="module")
async def client(server):
    async with patient(server.url) as made:
        yield made


class Subscribed:
    """A subscription of a client, its publish responses as they come."""

    def __init__(self, client):
        self.client = client
        self.messages = []
        self.values = {}
        self.id = None
        self.revised = None

    @classmethod
    async def to(cls, client, *nodes, interval=50.0, priority=0, most=0, **asked):
        made = cls(client)
        parameters = ua.CreateSubscriptionParameters(interval, 10_000, 20, most, True, priority)
        made.revised = await client.uaclient.create_subscription(parameters, made.take)
        made.id = made.revised.SubscriptionId
        made.items = [await made.add(node, number, **asked) for number, node in enumerate(nodes)]
        return made

    async def add(
        self,
        node,
        handle,
        *,
        size=1_000,
        sampling=0.0,
        wish=None,
        oldest=True,
        mode=ua.MonitoringMode.Reporting,
        index_range=None,
        attribute=ua.AttributeIds.Value,
        stamps=ua.TimestampsToReturn.Both,
    ):
        item = ua.MonitoredItemCreateRequest(
            ua.ReadValueId(node, attribute, index_range),
            mode,
            ua.MonitoringParameters(handle, sampling, wish, size, oldest),
        )
        parameters = ua.CreateMonitoredItemsParameters(self.id, stamps, [item])
        (result,) = await self.client.uaclient.create_monitored_items(parameters)
        return result

    async def take(self, result):
        self.messages.append(result)
        for notification in result.NotificationMessage.NotificationData or []:
            for item in getattr(notification, "MonitoredItems", []):
                self.values.setdefault(item.ClientHandle, []).append(item.Value)

    def seen(self, handle=0):
        return [value.Value.Value for value in self.values.get(handle, [])]

    async def end(self):
        await self.client.uaclient.delete_subscriptions([self.id])


async def code_of(awaitable):
    try:
        await awaitable
    except ua.UaStatusCodeError as error:
        return error.code
    return Codes.Good


def show(server, values, variable=None, code=0):
    variable = variable or server.flow
    for number, value in enumerate(values):
        server.write([(variable, value, code, T0 + number * 1_000_000)])


async def until(condition, patience=3.0):
    async with asyncio.timeout(patience):
        while not condition():  # noqa: ASYNC110 - what comes over a socket sets no event
            await asyncio.sleep(0.01)


async def test_both_timestamps_come_with_every_value(server, client):
    server.write([(server.flow, 1.0, 0, T0 + 1_234_567_000)])
    wanted = [ua.ReadValueId(server.flow.id, ua.AttributeIds.Value)]
    parameters = ua.ReadParameters(0, ua.TimestampsToReturn.Both, wanted)
    (read,) = await client.uaclient.read(parameters)
    assert read.SourceTimestamp.timestamp() == pytest.approx(T0 / 1e9 + 1.234567)
    assert abs(read.ServerTimestamp.timestamp() - time.time()) < 5
    subscribed = await Subscribed.to(client, server.flow.id)
    await until(lambda: subscribed.values)
    assert subscribed.values[0][0].SourceTimestamp == read.SourceTimestamp
    await subscribed.end()


async def test_a_bad_value_is_empty_an_uncertain_one_is_kept(server, client):
    node = client.get_node(server.flow.id)
    server.write([(server.flow, 5.0, Codes.UncertainSensorNotAccurate, T0)])
    read = await node.read_data_value(raise_on_bad_status=False)
    assert (read.Value.Value, read.StatusCode.value) == (5.0, Codes.UncertainSensorNotAccurate)
    server.write([(server.flow, 5.0, Codes.BadSensorFailure, T0)])
    read = await node.read_data_value(raise_on_bad_status=False)
    assert (read.Value.Value, read.StatusCode.value) == (None, Codes.BadSensorFailure)
    show(server, [0.0])


async def test_what_was_never_written_waits_for_its_first_value(server, client):
    read = await client.get_node(server.empty.id).read_data_value(raise_on_bad_status=False)
    assert read.StatusCode.value == Codes.BadWaitingForInitialData


async def test_a_part_of_an_array_is_read_alone(server, client):
    wanted = [
        ua.ReadValueId(server.table.id, ua.AttributeIds.Value, text)
        for text in ("0", "1:2", "3", "x", "1:1")
    ]
    read = await client.uaclient.read(ua.ReadParameters(0, ua.TimestampsToReturn.Both, wanted))
    assert [value.Value.Value for value in read[:2]] == [[1.0], [2.0, 3.0]]
    codes = [value.StatusCode.value for value in read[2:]]
    invalid = Codes.BadIndexRangeInvalid
    assert codes == [Codes.BadIndexRangeNoData, invalid, invalid]


async def test_an_enumeration_tells_its_strings(server, client):
    node = client.get_node(server.mode.id)
    strings = await (await node.get_child("0:EnumStrings")).read_value()
    assert [text.Text for text in strings] == ["Off", "On"]


async def test_reading_answers_each_node_for_itself(server, client):
    wanted = [
        ua.ReadValueId(ua.NodeId("Nothing", 2), ua.AttributeIds.Value),
        ua.ReadValueId(server.folder, ua.AttributeIds.Value),
        ua.ReadValueId(server.flow.id, 99),
        ua.ReadValueId(server.flow.id, ua.AttributeIds.BrowseName),
    ]
    read = await client.uaclient.read(ua.ReadParameters(0, ua.TimestampsToReturn.Both, wanted))
    assert [value.StatusCode.value for value in read] == [
        Codes.BadNodeIdUnknown,
        Codes.BadAttributeIdInvalid,
        Codes.BadAttributeIdInvalid,
        Codes.Good,
    ]
    bad_age = client.uaclient.read(ua.ReadParameters(-1.0, ua.TimestampsToReturn.Both, wanted))
    assert await code_of(bad_age) == Codes.BadMaxAgeInvalid
    nothing = client.uaclient.read(ua.ReadParameters(0, ua.TimestampsToReturn.Both, []))
    assert await code_of(nothing) == Codes.BadNothingToDo


async def test_browsing_goes_on_behind_a_continuation_point(server, client):
    wanted = ua.BrowseDescription(
        server.folder,
        ua.BrowseDirection.Forward,
        ua.NodeId(ua.ObjectIds.HierarchicalReferences),
        True,
        0,
        63,
    )
    parameters = ua.BrowseParameters(ua.ViewDescription(), 2, [wanted])
    (page,) = await client.uaclient.browse(parameters)
    names = [reference.BrowseName.Name for reference in page.References]
    while page.ContinuationPoint:
        asked = ua.BrowseNextParameters(False, [page.ContinuationPoint])
        (page,) = await client.uaclient.browse_next(asked)
        names += [reference.BrowseName.Name for reference in page.References]
    assert names == ["Flow", "Table", "Count", "Mode", "Empty"]
    again = ua.BrowseNextParameters(False, [b"x" * 16])
    (invalid,) = await client.uaclient.browse_next(again)
    assert invalid.StatusCode.value == Codes.BadContinuationPointInvalid


async def test_continuation_points_run_out_and_are_released(server, client):
    wanted = ua.BrowseDescription(
        server.folder, ua.BrowseDirection.Forward, ua.NodeId(), True, 0, 63
    )
    parameters = ua.BrowseParameters(ua.ViewDescription(), 1, [wanted, wanted, wanted])
    first, second, third = await client.uaclient.browse(parameters)
    assert third.StatusCode.value == Codes.BadNoContinuationPoints
    points = [first.ContinuationPoint, second.ContinuationPoint]
    await client.uaclient.browse_next(ua.BrowseNextParameters(True, points))
    (once_more,) = await client.uaclient.browse(
        ua.BrowseParameters(ua.ViewDescription(), 1, [wanted])
    )
    assert once_more.StatusCode.is_good()


async def test_browsing_says_what_is_wrong(server, client):
    def wanted(node=server.folder, reference=None, direction=ua.BrowseDirection.Forward):
        return ua.BrowseDescription(node, direction, reference or ua.NodeId(), True, 0, 63)

    results = await client.uaclient.browse(
        ua.BrowseParameters(
            ua.ViewDescription(),
            0,
            [
                wanted(ua.NodeId("Nothing", 2)),
                wanted(reference=server.folder),
                wanted(direction=ua.BrowseDirection.Invalid),
            ],
        )
    )
    assert [result.StatusCode.value for result in results] == [
        Codes.BadNodeIdUnknown,
        Codes.BadReferenceTypeIdInvalid,
        Codes.BadBrowseDirectionInvalid,
    ]
    view = ua.ViewDescription(ViewId=server.folder)
    (result,) = await client.uaclient.browse(ua.BrowseParameters(view, 0, [wanted()]))
    assert result.StatusCode.value == Codes.BadViewIdUnknown


async def test_only_what_was_asked_of_a_reference_is_told(server, client):
    wanted = ua.BrowseDescription(
        server.folder,
        ua.BrowseDirection.Forward,
        ua.NodeId(ua.ObjectIds.HasComponent),
        True,
        ua.NodeClass.Variable,
        ua.BrowseResultMask.DisplayName,
    )
    (result,) = await client.uaclient.browse(ua.BrowseParameters(ua.ViewDescription(), 0, [wanted]))
    reference = result.References[0]
    assert reference.DisplayName.Text == "Flow"
    assert reference.BrowseName.Name is None
    assert reference.ReferenceTypeId.is_null()


async def test_intervals_and_counts_are_revised_truthfully(server, client):
    for asked, revised in ((0.5, 50.0), (float("nan"), 50.0), (200.0, 200.0), (1e12, 3.6e6)):
        subscribed = await Subscribed.to(client, interval=asked)
        assert subscribed.revised.RevisedPublishingInterval == revised
        counts = subscribed.revised
        assert counts.RevisedLifetimeCount >= 3 * counts.RevisedMaxKeepAliveCount
        await subscribed.end()
    subscribed = await Subscribed.to(client, server.flow.id, interval=100.0)
    for asked, revised in ((0.0, 0.0), (10.0, 0.0), (-1.0, 100.0), (250.0, 250.0)):
        item = await subscribed.add(server.table.id, 7, sampling=asked)
        assert item.RevisedSamplingInterval == revised
        await client.uaclient.delete_monitored_items(
            ua.DeleteMonitoredItemsParameters(subscribed.id, [item.MonitoredItemId])
        )
    for asked, revised in ((0, 1), (1, 1), (77, 77), (10**6, 10_000)):
        item = await subscribed.add(server.table.id, 7, size=asked)
        assert item.RevisedQueueSize == revised
        await client.uaclient.delete_monitored_items(
            ua.DeleteMonitoredItemsParameters(subscribed.id, [item.MonitoredItemId])
        )
    await subscribed.end()


async def test_a_deadband_in_percent_of_the_range_holds_small_changes_back(server, client):
    show(server, [0.0])
    wish = ua.DataChangeFilter(ua.DataChangeTrigger.StatusValue, ua.DeadbandType.Percent, 5.0)
    subscribed = await Subscribed.to(client, server.flow.id, wish=wish)
    await until(lambda: subscribed.values)
    show(server, [9.0, 10.0, 10.5, 20.0, 21.0])
    await until(lambda: len(subscribed.seen()) >= 3)
    assert subscribed.seen() == [0.0, 10.5, 21.0]
    await subscribed.end()


async def test_an_item_that_cannot_be_monitored_says_why(server, client):
    subscribed = await Subscribed.to(client)
    percent = ua.DataChangeFilter(ua.DataChangeTrigger.StatusValue, ua.DeadbandType.Percent, 5.0)
    for node, asked, code in (
        (ua.NodeId("Nothing", 2), {}, Codes.BadNodeIdUnknown),
        (server.folder, {}, Codes.BadAttributeIdInvalid),
        (server.table.id, {"index_range": "x"}, Codes.BadIndexRangeInvalid),
        (server.table.id, {"wish": percent}, Codes.BadMonitoredItemFilterUnsupported),
        (server.table.id, {"wish": ua.EventFilter()}, Codes.BadFilterNotAllowed),
        (server.folder, {"attribute": ua.AttributeIds.EventNotifier}, Codes.BadNotSupported),
    ):
        result = await subscribed.add(node, 1, **asked)
        assert result.StatusCode.value == code
    await subscribed.end()


async def test_an_overflow_is_flagged_and_counted(server, client):
    subscribed = await Subscribed.to(client, server.count.id, size=5, interval=200.0, wish=EVERY)
    await until(lambda: subscribed.values)
    subscribed.values.clear()
    lost = server.counters.lost_notifications
    show(server, range(20), server.count)
    await until(lambda: subscribed.values)
    assert subscribed.seen() == [15, 16, 17, 18, 19]
    assert [value.StatusCode.value for value in subscribed.values[0]] == [0x480, 0, 0, 0, 0]
    assert server.counters.lost_notifications == lost + 15
    await subscribed.end()


async def test_many_notifications_come_in_several_messages_and_none_is_lost(server, client):
    subscribed = await Subscribed.to(client, server.count.id, most=10, wish=EVERY)
    await until(lambda: subscribed.values)
    subscribed.messages.clear()
    subscribed.values.clear()
    show(server, range(95), server.count)
    await until(lambda: len(subscribed.seen()) == 95)
    assert subscribed.seen() == list(range(95))
    more = [message.MoreNotifications for message in subscribed.messages[:10]]
    assert more == [True] * 9 + [False]
    sizes = [
        len(message.NotificationMessage.NotificationData[0].MonitoredItems)
        for message in subscribed.messages[:10]
    ]
    assert sizes == [10] * 9 + [5]
    await subscribed.end()


async def test_messages_are_numbered_without_gap_and_keep_alives_take_no_number(server, client):
    parameters = ua.CreateSubscriptionParameters(50.0, 100, 1, 0, True, 0)
    subscribed = Subscribed(client)
    subscribed.revised = await client.uaclient.create_subscription(parameters, subscribed.take)
    subscribed.id = subscribed.revised.SubscriptionId
    await subscribed.add(server.count.id, 0, wish=EVERY)
    for number in range(4):
        show(server, [number], server.count)
        await asyncio.sleep(0.12)
    await until(lambda: len(subscribed.messages) > 6)
    expected = 1
    for message in subscribed.messages:
        assert message.NotificationMessage.SequenceNumber == expected
        expected += bool(message.NotificationMessage.NotificationData)
    assert any(not m.NotificationMessage.NotificationData for m in subscribed.messages)
    await subscribed.end()


async def test_publishing_can_be_switched_off_and_on(server, client):
    subscribed = await Subscribed.to(client, server.count.id, wish=EVERY)
    await until(lambda: subscribed.values)
    subscribed.values.clear()
    await client.uaclient.set_publishing_mode(
        ua.SetPublishingModeParameters(False, [subscribed.id])
    )
    show(server, [21, 22, 23], server.count)
    await asyncio.sleep(0.2)
    assert not subscribed.values
    await client.uaclient.set_publishing_mode(ua.SetPublishingModeParameters(True, [subscribed.id]))
    await until(lambda: subscribed.seen() == [21, 22, 23])
    await subscribed.end()


async def test_a_subscription_is_modified_for_real(server, client):
    subscribed = await Subscribed.to(client, server.count.id, interval=10_000.0, wish=EVERY)
    parameters = ua.ModifySubscriptionParameters(subscribed.id, 60.0, 100, 10, 0, 0)
    result = await client.uaclient.modify_subscription(parameters)
    assert result.RevisedPublishingInterval == 60.0
    show(server, [5], server.count)
    await until(lambda: 5 in subscribed.seen(), 1.0)
    await subscribed.end()


async def test_an_item_is_modified_for_real(server, client):
    subscribed = await Subscribed.to(client, server.count.id, size=100, wish=EVERY)
    item = subscribed.items[0].MonitoredItemId
    request = ua.MonitoredItemModifyRequest(item, ua.MonitoringParameters(33, 0.0, EVERY, 2, True))
    unknown = ua.MonitoredItemModifyRequest(999, ua.MonitoringParameters(1, 0.0, None, 2, True))
    parameters = ua.ModifyMonitoredItemsParameters(
        subscribed.id, ua.TimestampsToReturn.Both, [request, unknown]
    )
    good, bad = await client.uaclient.modify_monitored_items(parameters)
    assert (good.RevisedQueueSize, good.RevisedSamplingInterval) == (2, 0.0)
    assert bad.StatusCode.value == Codes.BadMonitoredItemIdInvalid
    await until(lambda: subscribed.values)
    show(server, range(10), server.count)
    await until(lambda: subscribed.seen(33)[-2:] == [8, 9])
    await subscribed.end()


async def test_a_sampled_item_reports_when_another_triggers_it(server, client):
    subscribed = await Subscribed.to(client, server.count.id, wish=EVERY)
    sampled = await subscribed.add(server.flow.id, 1, mode=ua.MonitoringMode.Sampling, wish=EVERY)
    await until(lambda: subscribed.values)
    show(server, [1.0, 2.0])
    await asyncio.sleep(0.15)
    assert 1 not in subscribed.values
    request = ua.SetTriggeringRequest()
    request.Parameters = ua.SetTriggeringParameters(
        subscribed.id, subscribed.items[0].MonitoredItemId, [sampled.MonitoredItemId, 999], []
    )
    data = await client.uaclient.session._send_request(request)
    response = ua.ua_binary.struct_from_binary(ua.SetTriggeringResponse, data)
    codes = [code.value for code in response.Parameters.AddResults]
    assert codes == [Codes.Good, Codes.BadMonitoredItemIdInvalid]
    show(server, [7], server.count)
    await until(lambda: subscribed.seen(1)[-2:] == [1.0, 2.0])
    await subscribed.end()


async def test_a_message_can_be_had_again_until_it_is_acknowledged(server):
    peer = await (await RawPeer.connect(server.url)).log_in()
    subscription = await _subscribe(peer, server.count.id)
    peer.send(ua.PublishRequest())
    first = (await peer.answer(ua.PublishResponse)).Parameters
    number = first.NotificationMessage.SequenceNumber
    assert first.AvailableSequenceNumbers == [number]

    async def again(sequence):
        request = ua.RepublishRequest()
        request.Parameters = ua.RepublishParameters(subscription, sequence)
        return await peer.call(request, ua.RepublishResponse)

    for _ in range(2):
        message = (await again(number)).NotificationMessage
        assert message.NotificationData == first.NotificationMessage.NotificationData
    assert await code_of(again(number + 1)) == Codes.BadMessageNotAvailable
    acks = [
        ua.SubscriptionAcknowledgement(subscription, number),
        ua.SubscriptionAcknowledgement(subscription, number + 7),
        ua.SubscriptionAcknowledgement(subscription + 1, number),
    ]
    show(server, [1], server.count)
    peer.send(ua.PublishRequest(Parameters=ua.PublishParameters(acks)))
    results = (await peer.answer(ua.PublishResponse)).Parameters.Results
    assert [result.value for result in results] == [
        Codes.Good,
        Codes.BadSequenceNumberUnknown,
        Codes.BadSubscriptionIdInvalid,
    ]
    assert await code_of(again(number)) == Codes.BadMessageNotAvailable
    peer.close()


async def test_a_publish_request_times_out_as_it_wished(server):
    peer = await (await RawPeer.connect(server.url)).log_in()
    await _subscribe(peer, server.count.id, interval=60_000.0)
    request = ua.PublishRequest()
    request.RequestHeader.TimeoutHint = 200
    peer.send(request)
    assert await code_of(peer.answer(ua.PublishResponse)) == Codes.BadTimeout
    peer.close()


async def test_what_belongs_to_another_session_cannot_be_touched(server, client):
    subscribed = await Subscribed.to(client, server.count.id, wish=EVERY)
    item = subscribed.items[0].MonitoredItemId
    await until(lambda: subscribed.values)
    thief = await (await RawPeer.connect(server.url)).log_in()
    own = await _subscribe(thief, server.flow.id)
    victim = subscribed.id
    attempts = (
        (ua.DeleteSubscriptionsRequest, ua.DeleteSubscriptionsParameters([victim])),
        (ua.ModifySubscriptionRequest, ua.ModifySubscriptionParameters(victim, 1e6)),
        (ua.SetPublishingModeRequest, ua.SetPublishingModeParameters(False, [victim])),
        (ua.RepublishRequest, ua.RepublishParameters(victim, 1)),
        (ua.TransferSubscriptionsRequest, ua.TransferSubscriptionsParameters([victim], True)),
        (ua.DeleteMonitoredItemsRequest, ua.DeleteMonitoredItemsParameters(victim, [item])),
        (ua.DeleteMonitoredItemsRequest, ua.DeleteMonitoredItemsParameters(own, [item])),
        (ua.SetMonitoringModeRequest, ua.SetMonitoringModeParameters(victim, 0, [item])),
        (ua.CreateMonitoredItemsRequest, ua.CreateMonitoredItemsParameters(victim, 2, [])),
    )
    for request, parameters in attempts:
        with contextlib.suppress(ua.UaStatusCodeError):
            response = await thief.call(
                request(Parameters=parameters),
                getattr(ua, request.__name__.replace("Request", "Response")),
            )
            results = getattr(response, "Results", None) or response.Parameters.Results
            codes = [getattr(result, "StatusCode", result).value for result in results]
            assert all(code >> 31 for code in codes), request
    thief.close()
    subscribed.values.clear()
    show(server, [11, 12, 13], server.count)
    await until(lambda: subscribed.seen() == [11, 12, 13])
    await subscribed.end()


async def test_a_subscription_moves_to_another_session_of_the_same_user_only(server):
    first, second, other = [await _logged_in(server, user) for user in ("oskar", "oskar", "erna")]
    subscribed = await Subscribed.to(first, server.count.id, wish=EVERY)
    await until(lambda: subscribed.values)
    wish = ua.TransferSubscriptionsParameters([subscribed.id, 9_999], True)
    denied, unknown = await other.uaclient.transfer_subscriptions(wish)
    assert denied.StatusCode.value == Codes.BadUserAccessDenied
    assert unknown.StatusCode.value == Codes.BadSubscriptionIdInvalid
    moved, _ = await second.uaclient.transfer_subscriptions(wish)
    assert moved.StatusCode.is_good()
    items = ua.SetPublishingModeParameters(True, [subscribed.id])
    (of_old,) = await first.uaclient.set_publishing_mode(items)
    (of_new,) = await second.uaclient.set_publishing_mode(items)
    assert (of_old.value, of_new.value) == (Codes.BadSubscriptionIdInvalid, Codes.Good)
    for one in (first, second, other):
        await one.disconnect()


@pytest.mark.waits
async def test_a_client_that_reconnects_by_itself_misses_nothing_within_its_queue(server):
    port = int(server.url.split(":")[2].split("/")[0])
    async with Proxy(port) as proxy:
        client = Client(f"opc.tcp://127.0.0.1:{proxy.port}/services/", timeout=2)
        await client.connect(auto_reconnect=True)
        seen = []

        class Handler:
            def datachange_notification(self, _, value, __):
                seen.append(value)

        show(server, [1_000], server.count)
        subscription = await client.create_subscription(50, Handler())
        await subscription.subscribe_data_change(
            client.get_node(server.count.id), queuesize=1_000, sampling_interval=0
        )
        await until(lambda: seen)
        for number in range(200):
            show(server, [number], server.count)
            if number in (40, 120):
                proxy.cut()
            await asyncio.sleep(0.01)
        await until(lambda: 199 in seen, 15.0)
        assert sorted(set(seen)) == [*range(200), 1_000]
        await client.disconnect()


async def test_a_session_taken_up_on_a_new_connection_keeps_its_subscriptions(server):
    peer = await (await RawPeer.connect(server.url)).log_in()
    subscription = await _subscribe(peer, server.count.id)
    peer.writer.transport.abort()
    later = await RawPeer.connect(server.url)
    await later.open()
    later.token = peer.token
    await later.activate()
    later.send(ua.PublishRequest())
    response = await later.answer(ua.PublishResponse)
    assert response.Parameters.SubscriptionId == subscription
    later.close()
    peer.close()


async def test_after_a_cut_what_was_lost_comes_before_the_news(server):
    peer = await (await RawPeer.connect(server.url)).log_in()
    subscription = await _subscribe(peer, server.count.id)
    peer.send(ua.PublishRequest())
    lost = (await peer.answer(ua.PublishResponse)).Parameters.NotificationMessage
    peer.writer.transport.abort()
    later = await RawPeer.connect(server.url)
    await later.open()
    later.token = peer.token
    await later.activate()
    show(server, [31], server.count)
    later.send(ua.PublishRequest())
    await asyncio.sleep(0.15)
    for number, code in ((lost.SequenceNumber, Codes.Good), (lost.SequenceNumber + 1, None)):
        request = ua.RepublishRequest()
        request.Parameters = ua.RepublishParameters(subscription, number)
        later.send(request)
        if code == Codes.Good:
            again = (await later.answer(ua.RepublishResponse)).NotificationMessage
            assert again.NotificationData == lost.NotificationData
        else:
            assert await code_of(later.answer(ua.RepublishResponse)) == (
                Codes.BadMessageNotAvailable
            )
    change = (await later.answer(ua.PublishResponse)).Parameters.NotificationMessage
    assert change.SequenceNumber == lost.SequenceNumber + 1
    later.close()
    peer.close()


async def test_a_session_is_not_taken_up_by_another_user(server):
    oskar = await _logged_in(server, "oskar")
    token = oskar.uaclient.session.authentication_token
    thief = await RawPeer.connect(server.url)
    await thief.open()
    thief.token = token
    assert await code_of(thief.activate()) == Codes.BadIdentityTokenRejected
    assert await oskar.get_node(server.flow.id).read_value() is not None
    thief.close()
    await oskar.disconnect()


async def test_a_session_ends_with_its_time_out(server):
    peer = await (await RawPeer.connect(server.url)).log_in()
    session = server._sessions.find(peer.token)
    session.timeout_s = 0.1
    await until(lambda: session.closed, 3.0)
    request = ua.ReadRequest()
    request.Parameters.NodesToRead = [ua.ReadValueId(server.flow.id, 13)]
    assert await code_of(peer.call(request, ua.ReadResponse)) == Codes.BadSessionIdInvalid
    peer.close()


async def test_a_forgotten_subscription_expires(server):
    peer = await (await RawPeer.connect(server.url)).log_in()
    parameters = ua.CreateSubscriptionParameters(50.0, 3, 1, 0, True, 0)
    made = await peer.call(
        ua.CreateSubscriptionRequest(Parameters=parameters), ua.CreateSubscriptionResponse
    )
    number = made.Parameters.SubscriptionId
    assert number in server._subscriptions.by_number
    await until(lambda: number not in server._subscriptions.by_number, 2.0)
    peer.send(ua.PublishRequest())
    assert await code_of(peer.answer(ua.PublishResponse)) == Codes.BadNoSubscription
    peer.close()


async def test_get_monitored_items_and_resend_data_serve_the_owner_alone(server, client):
    subscribed = await Subscribed.to(client, server.count.id)
    await until(lambda: subscribed.values)
    subscribed.values.clear()
    number = ua.Variant(subscribed.id, ua.VariantType.UInt32)
    list_ = ua.NodeId(ua.ObjectIds.Server_GetMonitoredItems)
    resend = ua.NodeId(ua.ObjectIds.Server_ResendData)
    numbers, handles = await client.nodes.server.call_method(list_, number)
    assert (numbers, handles) == ([subscribed.items[0].MonitoredItemId], [0])
    await client.nodes.server.call_method(resend, number)
    await until(lambda: subscribed.values)
    async with patient(server.url) as other:
        for method in (list_, resend):
            call = other.nodes.server.call_method(method, number)
            assert await code_of(call) == Codes.BadUserAccessDenied
    await subscribed.end()


@pytest.mark.waits
async def test_limits_and_status_are_announced_as_they_are(server, client):
    async def read(name):
        return await client.get_node(getattr(ua.ObjectIds, name)).read_value()

    limits = server.settings.limits
    capabilities = "Server_ServerCapabilities"
    assert await read(f"{capabilities}_OperationLimits_MaxNodesPerRead") == limits.operations
    assert await read(f"{capabilities}_OperationLimits_MaxNodesPerMethodCall") == (
        limits.method_calls
    )
    assert await read(f"{capabilities}_MaxSessions") == limits.sessions
    assert await read(f"{capabilities}_MaxBrowseContinuationPoints") == 2
    assert await read("Server_ServiceLevel") == 255
    assert await read("Server_ServerStatus_State") == ua.ServerState.Running
    assert await read("Server_ServerArray") == ["urn:test:services"]
    assert (await read("Server_NamespaceArray"))[1:] == ["urn:test:services", "urn:services"]
    assert await read("Server_ServerDiagnostics_EnabledFlag")
    summary = await read("Server_ServerDiagnostics_ServerDiagnosticsSummary")
    assert summary.CurrentSessionCount >= 0
    server.announcements.set_service_level(100)
    assert await read("Server_ServiceLevel") == 100
    server.announcements.set_service_level(255)
    before = await read("Server_ServerStatus_CurrentTime")
    await asyncio.sleep(1.2)
    assert await read("Server_ServerStatus_CurrentTime") > before


async def test_what_is_not_diagnosed_says_so(client):
    for name in (
        "SubscriptionDiagnosticsArray",
        "SamplingIntervalDiagnosticsArray",
        "SessionsDiagnosticsSummary_SessionDiagnosticsArray",
        "SessionsDiagnosticsSummary_SessionSecurityDiagnosticsArray",
    ):
        node = client.get_node(getattr(ua.ObjectIds, f"Server_ServerDiagnostics_{name}"))
        assert await code_of(node.read_value()) == Codes.BadNotSupported


async def test_events_of_the_server_reach_a_client_that_asks_for_them(server, client):
    events = []

    class Listen:
        def event_notification(self, event):
            events.append(event.Message.Text)

    generator = await server.ua.get_event_generator()
    subscription = await client.create_subscription(50, Listen())
    await subscription.subscribe_events()
    await generator.trigger(message="the filter is clogged")
    await until(lambda: events)
    assert events == ["the filter is clogged"]
    await subscription.delete()


async def _logged_in(server, user):
    client = patient(server.url)
    client.set_user(user)
    client.set_password(PASSWORD)
    await client.connect()
    return client


async def _subscribe(peer, node, interval=50.0):
    parameters = ua.CreateSubscriptionParameters(interval, 10_000, 1_000, 0, True, 0)
    made = await peer.call(
        ua.CreateSubscriptionRequest(Parameters=parameters), ua.CreateSubscriptionResponse
    )
    number = made.Parameters.SubscriptionId
    item = ua.MonitoredItemCreateRequest(
        ua.ReadValueId(node, ua.AttributeIds.Value),
        ua.MonitoringMode.Reporting,
        ua.MonitoringParameters(1, 0.0, EVERY, 100, True),
    )
    request = ua.CreateMonitoredItemsRequest()
    request.Parameters = ua.CreateMonitoredItemsParameters(
        number, ua.TimestampsToReturn.Both, [item]
    )
    await peer.call(request, ua.CreateMonitoredItemsResponse)
    return number
