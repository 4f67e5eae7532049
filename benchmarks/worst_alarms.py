"""The worst that the limits allow of alarms and histories; see :mod:`benchmarks.worst_loads`."""

import asyncio
import contextlib
import time

from asyncua import ua
from asyncua.crypto import uacrypto
from asyncua.crypto.security_policies import encrypt_asymmetric
from asyncua.ua import ua_binary

from benchmarks.hostile_past import ALARMS, SERVER, STEP, T0, VALUES, alarm, condition_id
from guarded_opcua.binary.encoding import instant
from tests.support.raw_peer import RawPeer

PAST = ua.NodeId("Plant.Past", 2)
SESSIONS, ITEMS_OF_EACH = 10, 50  # the 500 items that may listen
CALLS, COMMENT = 100, 4_000
DEPTH = 20  # of the paths in a filter: with more of them it is not decoded
BASIC256SHA256 = "http://opcfoundation.org/UA/SecurityPolicy#Basic256Sha256"
Ids, Op = ua.ObjectIds, ua.FilterOperator
EVER = instant(T0 - STEP), instant(T0 + STEP * VALUES)


async def event_filters(url, until):
    """Listen with all items that there may be, and filters as dear as they may be."""
    peers = [await (await RawPeer.connect(url)).log_in() for _ in range(SESSIONS)]
    for peer in peers:
        await listening(peer, ITEMS_OF_EACH)
    await asyncio.gather(*(heard(peer, until) for peer in peers))


async def history_reads(url, until):
    """Read all of the past there is: raw, at times, as aggregates, as events; leave pages open."""
    peer = await (await RawPeer.connect(url)).log_in()
    times = [instant(T0 + STEP * k + 5) for k in range(0, 1_000_000, 1_000)]
    average = [ua.NodeId(Ids.AggregateFunction_TimeAverage)]
    config = ua.AggregateConfiguration(UseServerCapabilitiesDefaults=True)
    asked = (
        (ua.ReadRawModifiedDetails(False, *EVER, 0, True), PAST, 1),  # noqa: FBT003
        (ua.ReadRawModifiedDetails(False, *EVER, 0, True), PAST, 100),  # noqa: FBT003
        (ua.ReadAtTimeDetails(times, UseSimpleBounds=True), PAST, 1),
        (ua.ReadProcessedDetails(*EVER, 1e4, average, config), PAST, 1),
        (ua.ReadProcessedDetails(*EVER, 20.0, average * 100, config), PAST, 100),
        (ua.ReadEventDetails(0, *EVER, dearest()), SERVER, 1),
        (ua.ReadEventDetails(0, *EVER, dearest()), SERVER, 100),
    )
    while time.monotonic() < until:
        for details, node, times_over in asked:
            request = ua.HistoryReadRequest()
            wanted = ua.HistoryReadValueId(node, ContinuationPoint=None)
            request.Parameters = ua.HistoryReadParameters(
                details,
                ua.TimestampsToReturn.Both,
                ReleaseContinuationPoints=False,
                NodesToRead=[wanted] * times_over,
            )
            peer.send(request)
        await taken(peer)


async def acknowledgements(url, until):
    """Comment on every alarm as an operator may, a hundred at once, and ask for refreshes."""
    peer = await RawPeer.connect(url)
    await peer.open()
    await peer.activate(operator(await peer.create_session(), b"correct horse"))
    number = await listening(peer, ITEMS_OF_EACH)
    comment = ua.Variant(ua.LocalizedText("x" * COMMENT, "en"), ua.VariantType.LocalizedText)
    remark, refresh = ua.NodeId(Ids.ConditionType_AddComment), Ids.ConditionType_ConditionRefresh
    calls = [
        ua.CallMethodRequest(
            condition_id(k),
            remark,
            [ua.Variant(alarm(k).event_id, ua.VariantType.ByteString), comment],
        )
        for k in range(ALARMS)
    ]
    again = ua.CallMethodRequest(
        ua.NodeId(Ids.ConditionType),
        ua.NodeId(refresh),
        [ua.Variant(number, ua.VariantType.UInt32)],
    )
    while time.monotonic() < until:
        for methods in (calls[:CALLS], [again] * CALLS):
            request = ua.CallRequest()
            request.Parameters.MethodsToCall = methods
            peer.send(request)
        for _ in range(20):
            peer.send(ua.PublishRequest())
        await taken(peer)


def operator(made, password):
    """The token of the operator, for a session as it was created."""
    token = ua.UserNameIdentityToken("username", "operator", password, None)
    if made.ServerCertificate:
        key = uacrypto.x509_from_der(made.ServerCertificate).public_key()
        secret = ua_binary.Primitives.Bytes.pack(password + made.ServerNonce)
        token.Password, token.EncryptionAlgorithm = encrypt_asymmetric(key, secret, BASIC256SHA256)
    return token


def dearest():
    """The filter that costs most: it asks everything, and passes nothing until the end."""
    kind = ua.NodeId(Ids.BaseEventType)
    names = ("Message", "EventId", "Time", "ConditionName", "Comment", "SourceName", "Severity")
    clauses = [field(kind, names[k % len(names)]) for k in range(200)]
    deep = ua.SimpleAttributeOperand(kind, [ua.QualifiedName("a")] * DEPTH, ua.AttributeIds.Value)
    message = field(kind, "Message")
    pattern = ua.LiteralOperand(ua.Variant("%e" * 49, ua.VariantType.String))
    elements = [
        element(Op.Or, ua.ElementOperand(1), ua.ElementOperand(2)),
        element(Op.Or, ua.ElementOperand(3), ua.ElementOperand(4)),
        element(Op.Like, message, pattern),
        element(Op.InList, message, *[deep] * 99),
        element(Op.InList, message, *[deep] * 98, message),
    ]
    return ua.EventFilter(clauses, ua.ContentFilter(elements))


def field(kind, name):
    return ua.SimpleAttributeOperand(kind, [ua.QualifiedName(name)], ua.AttributeIds.Value)


def element(operator, *operands):
    return ua.ContentFilterElement(operator, list(operands))


async def listening(peer, count):
    """Monitor the server's events; the number of the subscription."""
    parameters = ua.CreateSubscriptionParameters(50.0, 10_000, 1_000, 0, True, 0)  # noqa: FBT003
    request = ua.CreateSubscriptionRequest(Parameters=parameters)
    made = await peer.call(request, ua.CreateSubscriptionResponse)
    number = made.Parameters.SubscriptionId
    wish = ua.MonitoringParameters(1, 0.0, dearest(), 1_000, True)  # noqa: FBT003
    wanted = ua.ReadValueId(SERVER, ua.AttributeIds.EventNotifier)
    one = ua.MonitoredItemCreateRequest(wanted, ua.MonitoringMode.Reporting, wish)
    for _ in range(count):
        create = ua.CreateMonitoredItemsRequest()
        create.Parameters = ua.CreateMonitoredItemsParameters(
            number, ua.TimestampsToReturn.Both, [one]
        )
        response = await peer.call(create, ua.CreateMonitoredItemsResponse)
        if not response.Results[0].StatusCode.is_good():
            break  # the limit of listeners
    return number


async def heard(peer, until):
    while time.monotonic() < until:
        for _ in range(5):
            peer.send(ua.PublishRequest())
        await taken(peer)


async def taken(peer):
    """Flush the send buffer and drop received bytes."""
    await asyncio.wait_for(peer.writer.drain(), 1.0)
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(0.05):
            if not await peer.reader.read(1_000_000):
                raise ConnectionError


WORST_OF_ALARMS = {load.__name__: load for load in (event_filters, history_reads, acknowledgements)}
