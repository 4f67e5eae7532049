"""The history of alarms: every change is an event that can be read again, by the same name."""

import datetime as dt

import pytest
import pytest_asyncio
from asyncua import ua
from asyncua.ua import ua_binary

from guarded_opcua.binary.encoding import instant
from guarded_opcua.history import events as past_events
from support.conditions import FIELDS, Event, Listener, S, event_filter, raised
from support.plant import START
from valvemap.opcua_results.results_server import NAMESPACE
from valvemap.storage.history import HistoryFile

pytestmark = pytest.mark.asyncio(loop_scope="module")

Codes, Ids, Op = ua.StatusCodes, ua.ObjectIds, ua.FilterOperator
EVER = START - 10 * S, START + 10_000 * S
SERVER = ua.NodeId(Ids.Server)
NO_TIME = dt.datetime(1601, 1, 1, tzinfo=dt.UTC)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def standing(tmp_path_factory):
    with HistoryFile(tmp_path_factory.mktemp("history") / "history.sqlite") as store:
        async with raised(store=store) as plant:
            yield plant


@pytest_asyncio.fixture(loop_scope="module")
async def listener(standing):
    await standing.calm()
    await standing.past.settle()
    standing.clock.advance(1.0)
    async with Listener.of(standing) as listener:
        yield listener


async def answered(client, node, span, *, n=0, filter_=None, point=None):
    """One HistoryReadResult of events."""
    start, end = (NO_TIME if t is None else instant(t) for t in span)
    details = ua.ReadEventDetails(n, start, end, filter_ or event_filter())
    request = ua.HistoryReadRequest()
    wanted = ua.HistoryReadValueId(node, ContinuationPoint=point)
    request.Parameters = ua.HistoryReadParameters(
        details, ReleaseContinuationPoints=False, NodesToRead=[wanted]
    )
    data = await client.uaclient.protocol.send_request(request)
    (result,) = ua_binary.struct_from_binary(ua.HistoryReadResponse, data).Results
    return result


def told(result):
    listed = getattr(result.HistoryData, "Events", None) or ()
    return [Event([field.Value for field in each.EventFields]) for each in listed]


async def read(client, node=SERVER, span=EVER, **more):
    """All pages: the events, and how many pages it took."""
    found, pages, point = [], 0, None
    while pages == 0 or point:
        result = await answered(client, node, span, point=point, **more)
        assert result.StatusCode.value in (Codes.Good, Codes.GoodNoData)
        found, pages, point = found + told(result), pages + 1, result.ContinuationPoint
    return found, pages


async def a_life(plant, listener):
    """A lag comes, is acknowledged, goes, is confirmed; the four events of it."""
    await plant.set_lag(0.3)
    (came,) = await listener.next()
    plant.clock.advance(1.0)
    await listener.act("Acknowledge", came, "seen")
    await plant.set_lag(0.0)
    plant.clock.advance(1.0)
    seen, gone = await listener.next(2)
    await listener.act("Confirm", came, "done")
    (over,) = await listener.next()
    await plant.past.settle()
    return [came, seen, gone, over]


def by_name(events):
    return sorted(event["EventId"] for event in events)


async def test_a_life_is_read_again_by_the_names_that_were_heard(standing, listener):
    heard = await a_life(standing, listener)
    index = await listener.namespace()
    for node in (SERVER, ua.NodeId("Identification", index), ua.NodeId("Valvistor", index)):
        found, pages = await read(listener.client, node)
        assert pages == 1
        again = {event["EventId"]: event for event in found}
        for event in heard:
            same = again[event["EventId"]]
            assert all(same[path] == event[path] for path in FIELDS)
            assert same.condition == event.condition
    assert [event["Time"] for event in found] == sorted(event["Time"] for event in found)
    of_service, _ = await read(listener.client, ua.NodeId("Service", index))
    assert of_service == []


async def test_pages_forwards_and_backwards_hold_each_event_once(standing, listener):
    await a_life(standing, listener)
    whole, _ = await read(listener.client)
    paged, pages = await read(listener.client, n=3)
    back, _ = await read(listener.client, span=EVER[::-1], n=3)
    assert len(whole) >= 4
    assert pages >= len(whole) // 3
    assert [e["EventId"] for e in paged] == [e["EventId"] for e in whole]
    assert by_name(back) == by_name(whole)
    assert [e["Time"] for e in back] == [e["Time"] for e in whole][::-1]
    (newest,), _ = await read(listener.client, span=(None, EVER[1]), n=1)
    assert newest["Time"] == whole[-1]["Time"]
    oldest, _ = await read(listener.client, span=(EVER[0], None), n=2)
    assert [e["EventId"] for e in oldest] == [e["EventId"] for e in whole[:2]]


async def test_a_filter_chooses_and_a_page_may_be_empty(standing, listener, monkeypatch):
    await a_life(standing, listener)
    name = ua.SimpleAttributeOperand(
        ua.NodeId(Ids.BaseEventType), [ua.QualifiedName("Retain")], ua.AttributeIds.Value
    )
    over = event_filter((Op.Equals, name, ua.LiteralOperand(ua.Variant(False))))  # noqa: FBT003
    found, _ = await read(listener.client, filter_=over)
    assert found
    assert not any(event["Retain"] for event in found)
    monkeypatch.setattr(past_events, "MOST_EVENTS", 1)
    one_by_one, pages = await read(listener.client, filter_=over)
    assert by_name(one_by_one) == by_name(found)
    assert pages > len(found)


async def test_a_restart_neither_forgets_nor_repeats(standing, listener):
    await standing.set_lag(0.3)
    await listener.next()
    await standing.past.settle()
    before, _ = await read(listener.client)
    await standing.restart()
    await standing.past.settle()
    async with Listener.of(standing, user=None) as observer:
        after, _ = await read(observer.client)
    assert by_name(after) == by_name(before)


async def test_what_cannot_be_asked_is_refused_with_the_reason(listener):
    client = listener.client
    index = await client.get_namespace_index(NAMESPACE)

    async def code(node=SERVER, span=EVER, **more):
        return (await answered(client, node, span, **more)).StatusCode.value

    assert await code(ua.NodeId("Nothing", index)) == Codes.BadNodeIdUnknown
    assert await code(ua.NodeId("Valvistor.RLS", index)) == Codes.BadHistoryOperationUnsupported
    assert await code(filter_=ua.EventFilter()) == Codes.BadEventFilterInvalid
    assert await code(span=(None, None), n=5) == Codes.BadHistoryOperationInvalid
    assert await code(span=(EVER[0], None)) == Codes.BadHistoryOperationInvalid
    assert await code(point=b"x" * 16) == Codes.BadContinuationPointInvalid
    assert await code(span=(EVER[1], EVER[1] + S)) == Codes.GoodNoData


async def test_the_server_says_that_events_are_remembered(listener):
    client = listener.client
    said = client.get_node(ua.NodeId(Ids.HistoryServerCapabilities_AccessHistoryEventsCapability))
    assert await said.read_value() is True
    server = client.get_node(SERVER)
    assert ua.EventNotifier.HistoryRead in await server.read_event_notifier()


async def test_whoever_remembers_says_which_fields_and_every_one_of_them_is_read(
    standing, listener
):
    await a_life(standing, listener)
    client = listener.client
    index = await client.get_namespace_index(NAMESPACE)
    for node in (SERVER, ua.NodeId("Valvistor", index), ua.NodeId("Service", index)):
        kept = await client.get_node(node).get_child("0:HistoricalEventFilter")
        filter_ = await kept.read_value()
        assert isinstance(filter_, ua.EventFilter)
    paths = ["/".join(name.Name for name in c.BrowsePath) for c in filter_.SelectClauses]
    assert set(FIELDS) <= set(paths)
    result = await answered(client, SERVER, EVER, filter_=filter_)
    values = [[field.Value for field in e.EventFields] for e in result.HistoryData.Events]
    read = [dict(zip(paths, each, strict=True)) for each in values]
    assert read
    assert all(event["ConditionName"] for event in read)
    assert all(any(event[path] is not None for event in read) for path in FIELDS)
