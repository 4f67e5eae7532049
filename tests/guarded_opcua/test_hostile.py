"""Peers that break the rules: each costs itself its connection, and nobody else anything."""

import asyncio
import contextlib
import random
import struct
import time

import pytest
import pytest_asyncio
from asyncua import ua
from asyncua.ua import ua_binary

from guarded_opcua import (
    HardenedServer,
    Limits,
    Role,
    ServerSettings,
    UserStore,
    add_object,
    add_variable,
)
from support.mutations import mutated
from support.mutations import requests as fuzz_requests
from support.raw_peer import Closed, RawPeer
from support.served import patient
from support.users import CHEAP

pytestmark = pytest.mark.asyncio(loop_scope="module")

Codes = ua.StatusCodes


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def server():
    users = UserStore(cost=CHEAP)
    users.add("operator", Role.OPERATOR, "correct horse")
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/hostile/",
        application_uri="urn:test:hostile",
        application_name="hostile",
        namespace_uri="urn:hostile",
        users=users,
        none_on_loopback=True,
        limits=Limits(
            connections=60,
            connections_per_host=40,
            connections_per_second=1_000,
            handshake_seconds=2.0,
            slow_reader_seconds=1.0,
            unsent_bytes_per_connection=64 * 1024,
            unsent_bytes=4 * 1024 * 1024,
        ),
    )
    made = await HardenedServer.create(settings)
    folder = await add_object(made, None, "Plant")
    made.big = await add_variable(made, folder, "Plant.Big", [0.5] * 20_000, dimensions=(0,))
    made.fast = await add_variable(made, folder, "Plant.Fast", 0.0)
    async with made:
        yield made


@pytest_asyncio.fixture(loop_scope="module")
async def peer(server):
    raw = await RawPeer.connect(server.url)
    yield raw
    raw.close()


@pytest_asyncio.fixture(autouse=True, loop_scope="module")
async def others_are_served(server):
    """After every attack a new client is answered, and soon."""
    yield
    async with asyncio.timeout(5.0), patient(server.url) as client:
        began = time.perf_counter()
        await client.get_node(server.fast.id).read_value()
        assert time.perf_counter() - began < 0.25


@pytest.mark.parametrize(
    "data",
    [
        b"GET / HTTP/1.1\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
        b"HELF" + struct.pack("<I", 2**31 - 1) + bytes(100),
        b"HELF" + struct.pack("<I", 7) + bytes(100),
        b"MSGF" + struct.pack("<I", 2**32 - 1) + bytes(100),
        b"HELC" + struct.pack("<I", 64) + bytes(100),
        b"ACKF" + struct.pack("<I", 28) + bytes(20),
        b"ERRF" + struct.pack("<I", 28) + bytes(20),
        b"OPNF" + struct.pack("<I", 64) + bytes(56),
        b"MSGF" + struct.pack("<I", 64) + bytes(56),
        bytes(5_000),
    ],
)
async def test_what_is_no_opc_ua_ends_the_connection(peer, data):
    peer.writer.write(data)
    assert await peer.is_closed()


@pytest.mark.parametrize(
    "changes",
    [
        {"ReceiveBufferSize": 0},
        {"SendBufferSize": 8_191},
        {"ReceiveBufferSize": 8_191},
        {"EndpointUrl": "x" * 4_097},
    ],
)
async def test_a_hello_that_asks_for_too_little_or_says_too_much_is_refused(peer, changes):
    with pytest.raises((ua.UaStatusCodeError, Closed)):
        await peer.hello(**changes)
    assert await peer.is_closed()


@pytest.mark.waits
async def test_a_peer_that_says_nothing_is_disconnected_in_time(peer):
    assert await peer.is_closed()


@pytest.mark.waits
async def test_a_peer_that_opens_a_channel_and_stays_silent_is_disconnected(peer):
    await peer.open()
    assert await peer.is_closed()


async def test_what_comes_before_a_session_is_bounded(peer):
    await peer.open()
    body = bytes(30_000)
    frame = b"MSGC" + struct.pack("<I", len(body) + 8) + body
    with contextlib.suppress(ConnectionError):
        for _ in range(10):
            peer.writer.write(frame)
            await peer.writer.drain()
    assert await peer.is_closed()


async def test_discovery_requests_without_a_session_are_bounded(peer):
    await peer.open()
    for _ in range(20):
        await peer.call(ua.GetEndpointsRequest(), ua.GetEndpointsResponse)
    with pytest.raises(ua.UaStatusCodeError) as caught:
        await peer.call(ua.GetEndpointsRequest(), ua.GetEndpointsResponse)
    assert caught.value.code == Codes.BadTcpServerTooBusy


@pytest.mark.parametrize(
    "request_",
    [
        ua.ReadRequest,
        ua.WriteRequest,
        ua.BrowseRequest,
        ua.CallRequest,
        ua.PublishRequest,
        ua.RepublishRequest,
        ua.CreateSubscriptionRequest,
        ua.TransferSubscriptionsRequest,
        ua.CloseSessionRequest,
        ua.ActivateSessionRequest,
        ua.AddNodesRequest,
        ua.HistoryReadRequest,
        ua.RegisterServerRequest,
    ],
)
async def test_nothing_is_done_without_a_session(peer, request_):
    await peer.open()
    with pytest.raises(ua.UaStatusCodeError) as caught:
        await peer.call(request_(), object)
    assert caught.value.code in (Codes.BadSessionIdInvalid, Codes.BadServiceUnsupported)


async def test_nothing_is_done_in_a_session_nobody_has_logged_in_to(peer):
    await peer.open()
    await peer.create_session()
    with pytest.raises(ua.UaStatusCodeError) as caught:
        await peer.call(ua.ReadRequest(), ua.ReadResponse)
    assert caught.value.code == Codes.BadSessionNotActivated


async def test_a_session_cannot_be_found_by_counting(server, peer):
    async with patient(server.url):
        await peer.open()
        tokens = [ua.NodeId(number) for number in range(1_000, 1_018)]
        for token in tokens:
            with pytest.raises(ua.UaStatusCodeError) as caught:
                await peer.call(ua.ActivateSessionRequest(), object, token)
            assert caught.value.code == Codes.BadSessionIdInvalid


async def test_tokens_are_random(peer):
    await peer.open()
    tokens = [(await peer.create_session()).AuthenticationToken for _ in range(3)]
    assert all(token.NodeIdType == ua.NodeIdType.ByteString for token in tokens)
    assert all(len(token.Identifier) == 32 for token in tokens)
    assert len({token.Identifier for token in tokens}) == 3


async def test_another_connection_cannot_use_a_session_it_knows_the_token_of(server, peer):
    await peer.log_in()
    thief = await RawPeer.connect(server.url)
    await thief.open()
    with pytest.raises(ua.UaStatusCodeError) as caught:
        await thief.call(ua.ReadRequest(), ua.ReadResponse, peer.token)
    assert caught.value.code == Codes.BadSecureChannelIdInvalid
    thief.close()


async def test_services_that_change_the_address_space_are_not_there(peer):
    await peer.log_in()
    for request in (
        ua.AddNodesRequest(),
        ua.DeleteNodesRequest(),
        ua.AddReferencesRequest(),
        ua.DeleteReferencesRequest(),
        ua.RegisterServerRequest(),
        ua.RegisterServer2Request(),
        ua.QueryFirstRequest(),
        ua.HistoryUpdateRequest(),
    ):
        with pytest.raises(ua.UaStatusCodeError) as caught:
            await peer.call(request, object)
        assert caught.value.code == Codes.BadServiceUnsupported


async def test_a_packet_that_declares_a_huge_array_is_refused_at_once(peer):
    await peer.log_in()
    request = ua.WriteRequest()
    request.RequestHeader.AuthenticationToken = peer.token
    head = ua_binary.struct_to_binary(request)[:-4]
    body = head + struct.pack("<i", 1) + bytes(3) + struct.pack("<Ii", 13, -1)
    for kind in (0x80, 0x80 | 12, 0x80 | 24):
        began = time.perf_counter()
        peer.send_body(body + b"\x01" + bytes((kind,)) + struct.pack("<i", 2**31 - 1) + bytes(20))
        with pytest.raises(ua.UaStatusCodeError) as caught:
            await peer.answer(ua.WriteResponse)
        assert caught.value.code == Codes.BadDecodingError
        assert time.perf_counter() - began < 0.2


async def test_a_connection_that_sends_rubbish_again_and_again_is_ended(peer):
    await peer.log_in()
    request = ua.ReadRequest()
    request.RequestHeader.AuthenticationToken = peer.token
    head = ua_binary.struct_to_binary(request)[:-16]
    for _ in range(30):
        peer.send_body(head)
    assert await peer.is_closed()


async def test_too_many_operations_are_refused(server, peer):
    await peer.log_in()
    request = ua.ReadRequest()
    request.Parameters.NodesToRead = [
        ua.ReadValueId(server.fast.id, ua.AttributeIds.Value) for _ in range(1_001)
    ]
    with pytest.raises(ua.UaStatusCodeError) as caught:
        await peer.call(request, ua.ReadResponse)
    assert caught.value.code == Codes.BadTooManyOperations


async def test_a_response_that_would_be_huge_is_refused(server, peer):
    await peer.log_in()
    request = ua.ReadRequest()
    request.Parameters.NodesToRead = [
        ua.ReadValueId(server.big.id, ua.AttributeIds.Value) for _ in range(1_000)
    ]
    with pytest.raises(ua.UaStatusCodeError) as caught:
        await peer.call(request, ua.ReadResponse)
    assert caught.value.code == Codes.BadResponseTooLarge


async def test_a_response_larger_than_the_peer_takes_is_refused(server, peer):
    await peer.hello(MaxMessageSize=10_000)
    peer.hello = lambda: asyncio.sleep(0)
    await peer.log_in()
    request = ua.ReadRequest()
    request.Parameters.NodesToRead = [ua.ReadValueId(server.big.id, ua.AttributeIds.Value)]
    with pytest.raises(ua.UaStatusCodeError) as caught:
        await peer.call(request, ua.ReadResponse)
    assert caught.value.code == Codes.BadResponseTooLarge


async def test_a_message_of_endless_chunks_is_refused(peer):
    await peer.log_in()
    for number in range(2, 200):
        chunk = struct.pack("<III", 13, number + 10_000, 99) + bytes(60_000)
        channel = struct.pack("<I", peer.channel.security_token.ChannelId)
        data = b"MSGC" + struct.pack("<I", 12 + len(chunk)) + channel + chunk
        with contextlib.suppress(ConnectionError):
            peer.writer.write(data)
            await peer.writer.drain()
    assert await peer.is_closed()


async def test_a_plain_text_password_is_refused(peer):
    await peer.open()
    await peer.create_session()
    token = ua.UserNameIdentityToken("username", "operator", b"correct horse", None)
    with pytest.raises(ua.UaStatusCodeError) as caught:
        await peer.activate(token)
    assert caught.value.code == Codes.BadIdentityTokenInvalid


async def test_too_many_connections_of_a_host_are_refused_and_the_others_stay(server, peer):
    await peer.log_in()
    flood = []
    for _ in range(60):
        with contextlib.suppress(ConnectionError):
            flood.append(await RawPeer.connect(server.url))
    await asyncio.sleep(0.1)
    closed = [one for one in flood if one.reader.at_eof() or one.reader.exception() is not None]
    assert len(closed) >= 20
    assert await peer.call(_read(server), ua.ReadResponse)
    for one in flood:
        one.close()
    await asyncio.sleep(0.1)


async def test_sessions_that_nobody_logs_in_to_give_way(server, peer):
    await peer.open()
    for _ in range(15):
        await peer.create_session()
    async with patient(server.url) as client:
        assert await client.get_node(server.fast.id).read_value() is not None


@pytest.mark.waits
async def test_a_peer_that_never_reads_is_disconnected_and_holds_little(server, peer):
    await peer.log_in()
    peer.reader._transport.pause_reading()
    request = ua.ReadRequest()
    request.Parameters.NodesToRead = [ua.ReadValueId(server.big.id, ua.AttributeIds.Value)] * 20
    for _ in range(100):
        peer.send(request)
    await asyncio.sleep(0.5)
    listener = server._listener
    assert (
        sum(connection.transport.get_write_buffer_size() for connection in listener._connections)
        < 8 * 1024 * 1024
    )
    await asyncio.sleep(2.5)
    peer.reader._transport.resume_reading()
    assert await peer.is_closed()


async def test_a_flood_of_requests_waits_for_itself(server, peer):
    await peer.log_in()
    for _ in range(3_000):
        peer.send(_read(server))
    async with patient(server.url) as client:
        waits = []
        for _ in range(50):
            began = time.perf_counter()
            await client.get_node(server.fast.id).read_value()
            waits.append(time.perf_counter() - began)
    assert sorted(waits)[25] < 0.05
    assert max(waits) < 0.25


async def test_large_responses_count_as_many_requests(server, peer):
    await peer.log_in()
    asked = 400
    for _ in range(asked):
        request = ua.ReadRequest()
        request.Parameters.NodesToRead = [ua.ReadValueId(server.big.id, ua.AttributeIds.Value)]
        peer.send(request)
    before = server.counters.requests
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(1.0):
            while await peer.reader.read(1_000_000):
                pass
    assert server.counters.requests - before < asked / 2


async def test_monitored_items_on_one_node_are_bounded(server, peer):
    await peer.log_in()
    subscription = await peer.call(
        ua.CreateSubscriptionRequest(
            Parameters=ua.CreateSubscriptionParameters(RequestedPublishingInterval=100.0)
        ),
        ua.CreateSubscriptionResponse,
    )
    request = ua.CreateMonitoredItemsRequest()
    request.Parameters.SubscriptionId = subscription.Parameters.SubscriptionId
    request.Parameters.ItemsToCreate = [
        ua.MonitoredItemCreateRequest(
            ua.ReadValueId(server.fast.id, ua.AttributeIds.Value),
            ua.MonitoringMode.Reporting,
            ua.MonitoringParameters(number, 0.0, None, 10),
        )
        for number in range(100)
    ]
    response = await peer.call(request, ua.CreateMonitoredItemsResponse)
    codes = [result.StatusCode.value for result in response.Results]
    assert codes.count(Codes.Good) == 5
    assert set(codes[5:]) == {Codes.BadTooManyMonitoredItems}


async def test_subscriptions_of_a_session_are_bounded(peer):
    await peer.log_in()
    for _ in range(20):
        await peer.call(ua.CreateSubscriptionRequest(), ua.CreateSubscriptionResponse)
    with pytest.raises(ua.UaStatusCodeError) as caught:
        await peer.call(ua.CreateSubscriptionRequest(), ua.CreateSubscriptionResponse)
    assert caught.value.code == Codes.BadTooManySubscriptions


async def test_publish_requests_of_a_session_are_bounded(peer):
    await peer.log_in()
    parameters = ua.CreateSubscriptionParameters(
        RequestedPublishingInterval=60_000.0, RequestedMaxKeepAliveCount=100
    )
    await peer.call(
        ua.CreateSubscriptionRequest(Parameters=parameters), ua.CreateSubscriptionResponse
    )
    for _ in range(60):
        peer.send(ua.PublishRequest())
    codes = []
    for _ in range(10):
        with pytest.raises(ua.UaStatusCodeError) as caught:
            await peer.answer(ua.PublishResponse)
        codes.append(caught.value.code)
    assert set(codes) == {Codes.BadTooManyPublishRequests}


async def test_mutated_packets_change_nothing_for_the_others(server):
    """A seeded fuzzer that knows the structure; the long run is marked soak."""
    await fuzz(server, seed=1, packets=500)


@pytest.mark.soak
async def test_ten_thousand_mutated_packets_change_nothing_for_the_others(server):
    await fuzz(server, seed=2, packets=10_000)


async def fuzz(server, seed, packets):
    dice = random.Random(seed)
    requests = fuzz_requests(server.fast.id)
    worst, watching = 0.0, True

    async def watch():
        nonlocal worst
        async with patient(server.url) as client:
            node = client.get_node(server.fast.id)
            while watching:
                began = time.perf_counter()
                await node.read_value()
                worst = max(worst, time.perf_counter() - began)
                await asyncio.sleep(0.005)

    watcher = asyncio.create_task(watch())
    before = server.counters.requests
    peer = None
    for _ in range(packets):
        if peer is None:
            peer = await (await RawPeer.connect(server.url)).log_in()
        body = bytearray(ua_binary.struct_to_binary(dice.choice(requests)(peer.token)))
        peer.send_body(mutated(body, dice))
        try:
            async with asyncio.timeout(0.01):
                ended = not await peer.reader.read(1_000_000)
        except TimeoutError:
            ended = False
        except ConnectionError:
            ended = True
        if ended:
            peer.close()
            await asyncio.sleep(0)
            peer = None
    if peer is not None:
        peer.close()
    watching = False
    await watcher
    assert server.counters.requests - before > 0.9 * packets
    assert worst < 0.25


def _read(server):
    request = ua.ReadRequest()
    request.Parameters.NodesToRead = [ua.ReadValueId(server.fast.id, ua.AttributeIds.Value)]
    return request
