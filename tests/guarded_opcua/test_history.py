"""HistoryRead of raw values, seen through asyncua's plain client over a real socket."""

import asyncio
import datetime as dt

import numpy as np
import pytest
import pytest_asyncio
from asyncua import ua

from guarded_opcua import (
    HardenedServer,
    Limits,
    Records,
    ServerError,
    ServerSettings,
    Span,
    add_object,
    add_variable,
)
from support.served import patient

pytestmark = pytest.mark.asyncio(loop_scope="module")

Codes = ua.StatusCodes
T0 = 1_800_000_000_000_000_000
MS = 1_000_000
VALUES, POINTS = 40, 3  # limits of the server


class Remembered:
    """Fulfils Historian, value by value."""

    def __init__(self):
        self.records = {}  # of each variable: (value, code, source)
        self.slow = None  # what an answer waits for

    def write(self, variable, value, source, code=0):
        self.records.setdefault(variable.id, []).append((value, code, source))

    def raw(self, variable, span, skip, most):
        found = self.expected(variable, span)[skip : skip + most]
        values, codes, source = (
            (np.array(x) for x in zip(*found, strict=True)) if found else [()] * 3
        )
        records = Records(
            np.array(values, float),
            np.array(codes, np.uint32),
            np.array(source, np.int64),
            np.array(source, np.int64) + MS,
        )
        return records if self.slow is None else self._later(records)

    def expected(self, variable, span):
        chosen = [r for r in self.records.get(variable, []) if span.low <= r[2] <= span.high]
        chosen = sorted(chosen, key=lambda record: record[2])
        return chosen[::-1] if span.backwards else chosen

    async def _later(self, records):
        await self.slow.wait()
        return records


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def server():
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/history/",
        application_uri="urn:test:history",
        application_name="history",
        namespace_uri="urn:history",
        none_on_loopback=True,
        limits=Limits(history_values=VALUES, history_continuation_points=POINTS),
    )
    made = await HardenedServer.create(settings)
    folder = await add_object(made, None, "Plant")
    made.flow = await add_variable(made, folder, "Plant.Flow", 0.0)
    made.count = await add_variable(made, folder, "Plant.Count", 0, type=ua.VariantType.UInt32)
    made.other = await add_variable(made, folder, "Plant.Other", 0.0)
    made.table = await add_variable(made, folder, "Plant.Table", [1.0], dimensions=(1,))
    made.memory = Remembered()
    made.add_history([made.flow, made.count], made.memory)
    rng = np.random.default_rng(7)
    steps = rng.choice([0, 1, 2, 5], 200)  # some share their time
    for k, t in enumerate(np.cumsum(steps)):
        code = (
            Codes.BadSensorFailure if k % 17 == 0 else Codes.UncertainLastUsableValue * (k % 5 == 0)
        )
        made.memory.write(made.flow, k / 8, T0 + int(t) * MS, int(code))
        made.memory.write(made.count, k, T0 + int(t) * MS)
    made.span_ms = int(steps.sum())
    async with made:
        yield made


@pytest_asyncio.fixture(loop_scope="module")
async def client(server):
    async with patient(server.url) as made:
        yield made


def moment(ns):
    return (
        None
        if ns is None
        else dt.datetime.fromtimestamp(0, dt.UTC) + dt.timedelta(microseconds=ns // 1_000)
    )


def raw(start=None, end=None, n=0, *, bounds=False, modified=False):
    nothing = dt.datetime(1601, 1, 1, tzinfo=dt.UTC)
    return ua.ReadRawModifiedDetails(
        modified, moment(start) or nothing, moment(end) or nothing, n, bounds
    )


async def read(client, nodes, details, *, release=False, stamps=ua.TimestampsToReturn.Both):
    """Results of a HistoryRead; each node may come with a continuation point."""
    request = ua.HistoryReadRequest()
    request.Parameters = ua.HistoryReadParameters(
        details,
        stamps,
        release,
        [
            ua.HistoryReadValueId(NodeId=getattr(node, "id", node), ContinuationPoint=point)
            for node, point in (n if isinstance(n, tuple) else (n, None) for n in nodes)
        ],
    )
    data = await client.uaclient.protocol.send_request(request)
    response = ua.ua_binary.struct_from_binary(ua.HistoryReadResponse, data)
    response.ResponseHeader.ServiceResult.check()
    return response.Results


def times(result):
    return [ns(value.SourceTimestamp) for value in result.HistoryData.DataValues]


def ns(time):
    return (ua.datetime_to_win_epoch(time) - ua.datetime_to_win_epoch(moment(0))) * 100


def values(result):
    return [value.Value.Value for value in result.HistoryData.DataValues]


async def whole(client, node, details):
    """All pages of one variable."""
    (result,) = await read(client, [node], details)
    pages = [result]
    while result.ContinuationPoint:
        (result,) = await read(client, [(node, result.ContinuationPoint)], details)
        pages.append(result)
    assert all(page.StatusCode.is_good() for page in pages)
    return [pair for page in pages for pair in zip(times(page), values(page), strict=True)]


async def test_all_of_a_span_comes_in_pages_each_value_once_and_in_order(server, client):
    rng = np.random.default_rng(1)
    for _ in range(25):
        a, b = (T0 + int(x) * MS for x in rng.integers(-5, server.span_ms + 5, 2))
        n = int(rng.choice([0, 1, 7, 30]))
        found = await whole(client, server.flow, raw(a, b, n))
        span = Span(a, b - 1) if a < b else Span(b + 1, a, backwards=True)
        span = Span(a, a) if a == b else span
        kept = server.memory.expected(server.flow.id, span)
        bad = 0x8000_0000
        assert found == [(t, None if code >= bad else value) for value, code, t in kept]


@pytest.mark.parametrize("backwards", [False, True])
async def test_a_number_of_values_from_one_time_on_is_just_that_many(server, client, backwards):
    middle = T0 + server.span_ms // 2 * MS
    details = raw(None, middle, 55) if backwards else raw(middle, None, 55)
    found = await whole(client, server.count, details)
    span = Span(0, middle, backwards=True) if backwards else Span(middle, 2**62)
    assert found == [(t, v) for v, _, t in server.memory.expected(server.count.id, span)[:55]]


async def test_bounds_are_the_values_beside_the_span_or_say_that_there_are_none(server, client):
    all_of_it = server.memory.expected(server.count.id, Span(0, 2**62))
    at = sorted({t for _, _, t in all_of_it})
    gap = next(k for k in range(50, len(at)) if at[k] - at[k - 1] > 2 * MS)
    a, b = at[gap] - MS, at[gap] + MS  # no value at a; perhaps one at b
    found = await whole(client, server.count, raw(a, b, bounds=True))
    assert found[0][0] == at[gap - 1]
    assert found[-1][0] == next(t for t in at if t >= b)
    (result,) = await read(client, [server.count], raw(T0 - MS, T0, bounds=True))
    assert result.HistoryData.DataValues[0].StatusCode.value == Codes.BadBoundNotFound
    assert times(result)[0] == T0 - MS


async def test_only_the_times_that_were_asked_for_come(server, client):
    for stamps, source, of_server in (
        (ua.TimestampsToReturn.Source, True, False),
        (ua.TimestampsToReturn.Server, False, True),
    ):
        (result,) = await read(client, [server.flow], raw(T0, T0 + 9 * MS), stamps=stamps)
        for value in result.HistoryData.DataValues:
            assert (value.SourceTimestamp is not None) == source
            assert (value.ServerTimestamp is not None) == of_server
    with pytest.raises(ua.uaerrors.BadTimestampsToReturnInvalid):
        await read(client, [server.flow], raw(T0, T0 + 1), stamps=ua.TimestampsToReturn.Neither)


async def test_a_response_holds_no_more_than_it_may_whatever_is_asked(server, client):
    details = raw(T0, T0 + 10**12, 10**6)
    results = await read(client, [server.flow, server.count], details)
    assert [len(result.HistoryData.DataValues) for result in results] == [VALUES // 2] * 2


async def test_continuation_points_are_few_the_sessions_own_and_released(server, client):
    details = raw(T0, T0 + 10**12, 1)
    results = await read(client, [server.flow] * (POINTS + 1), details)
    assert [r.StatusCode.value for r in results] == [0] * POINTS + [Codes.BadNoContinuationPoints]
    points = [result.ContinuationPoint for result in results[:POINTS]]
    async with patient(server.url) as stranger:
        (result,) = await read(stranger, [(server.flow, points[0])], details)
        assert result.StatusCode.value == Codes.BadContinuationPointInvalid
    (result,) = await read(client, [(server.count, points[0])], details)
    assert result.StatusCode.value == Codes.BadContinuationPointInvalid
    released = await read(client, [(server.flow, p) for p in points], details, release=True)
    assert all(result.StatusCode.is_good() and not result.HistoryData for result in released)
    again = await read(client, [(server.flow, p) for p in points], details)
    assert {r.StatusCode.value for r in again} == {Codes.BadContinuationPointInvalid}
    (result,) = await read(client, [server.flow], details)
    assert result.ContinuationPoint


@pytest.mark.parametrize(
    ("details", "code"),
    [
        (raw(T0, T0 + 1, modified=True), Codes.BadHistoryOperationUnsupported),
        (ua.ReadEventDetails(), Codes.BadHistoryOperationUnsupported),
        (raw(T0), Codes.BadHistoryOperationInvalid),
        (raw(n=5), Codes.BadHistoryOperationInvalid),
        (raw(T0 - 10 * MS, T0), Codes.GoodNoData),
    ],
    ids=["modified", "events", "start alone", "number alone", "no data"],
)
async def test_what_is_not_there_is_said(server, client, details, code):
    (result,) = await read(client, [server.flow], details)
    assert result.StatusCode.value == code


async def test_only_what_has_a_history_can_be_asked_for_it(server, client):
    nodes = [server.other.id, ua.NodeId(ua.ObjectIds.Server), ua.NodeId("Nowhere", 2)]
    results = await read(client, nodes, raw(T0, T0 + 1))
    said = [result.StatusCode.name for result in results]
    assert said == [*(["BadHistoryOperationUnsupported"] * 2), "BadNodeIdUnknown"]
    for variable, kept in ((server.flow, True), (server.other, False)):
        node = client.get_node(variable.id)
        for level in (await node.get_access_level(), await node.get_user_access_level()):
            assert (ua.AccessLevel.HistoryRead in level) == kept
        historizing = await node.read_attribute(ua.AttributeIds.Historizing)
        assert historizing.Value.Value == kept
    with pytest.raises(ServerError, match="scalar numbers"):
        server.add_history([server.table], server.memory)


async def test_what_the_server_can_is_announced(server, client):
    async def said_of(node):
        return await client.get_node(node).read_value()

    assert await said_of(ua.ObjectIds.HistoryServerCapabilities_AccessHistoryDataCapability)
    assert not await said_of(ua.ObjectIds.HistoryServerCapabilities_AccessHistoryEventsCapability)
    assert not await said_of(ua.ObjectIds.HistoryServerCapabilities_DeleteRawCapability)
    assert await said_of(ua.ObjectIds.HistoryServerCapabilities_MaxReturnDataValues) == VALUES
    points = ua.ObjectIds.Server_ServerCapabilities_MaxHistoryContinuationPoints
    assert await said_of(points) == POINTS


async def test_a_historian_that_takes_its_time_holds_up_nobody_else(server, client):
    server.memory.slow = asyncio.Event()
    try:
        reading = asyncio.create_task(read(client, [server.flow], raw(T0, T0 + 9 * MS)))
        async with patient(server.url) as other:
            assert await other.get_node(server.other.id).read_value() == 0.0
        assert not reading.done()
        server.memory.slow.set()
        (result,) = await reading
        assert values(result)
    finally:
        server.memory.slow = None


async def test_asyncuas_own_client_reads_it(server, client):
    found = await client.get_node(server.count.id).read_raw_history(
        moment(T0), moment(T0 + server.span_ms * MS + MS), return_bounds=False
    )
    kept = server.memory.expected(server.count.id, Span(0, 2**62))
    assert [value.Value.Value for value in found] == [value for value, _, _ in kept]


async def test_who_reads_much_pays_for_it(server, client):
    (connection,) = {s.line for s in server._sessions if s.line is not None and s.active}
    before = connection._allowance._left, connection.cost.finished
    for _ in range(20):
        await read(client, [server.flow], raw(T0, T0 + 10**12, 1), release=False)
    assert connection._allowance._left < before[0] or connection.cost.finished > before[1]
