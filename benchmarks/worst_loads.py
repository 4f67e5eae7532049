"""The worst requests that keep within every announced limit, service by service.

Each load logs in as an anonymous client, fills the limits, and repeats the most
expensive request of one service.
"""

import asyncio
import contextlib
import itertools
import time

from asyncua import ua

from tests.support.raw_peer import RawPeer

COUNTER = ua.NodeId("Plant.Counter", 2)
SINGLES = [ua.NodeId(f"Plant.Single{number}", 2) for number in range(200)]
ITEMS, AT_ONCE = 9_990, 1_000
_ATTRIBUTES = (ua.AttributeIds.DisplayName, ua.AttributeIds.BrowseName, ua.AttributeIds.NodeClass)
Ids, Mode = ua.ObjectIds, ua.MonitoringMode
WISH = ua.MonitoringParameters(1, 0.0, None, 10_000, True)  # noqa: FBT003 - discard the oldest


async def triggering(url, until):
    """Let five items of a counter trigger all others."""
    peer, number = await ready(url)
    items = await filled(peer, number, Mode.Sampling)
    request = ua.CreateMonitoredItemsRequest()
    five = [created(COUNTER, ua.AttributeIds.Value, Mode.Reporting)] * 5
    request.Parameters = ua.CreateMonitoredItemsParameters(number, BOTH, five)
    response = await peer.call(request, ua.CreateMonitoredItemsResponse)
    for trigger in [result.MonitoredItemId for result in response.Results]:
        for some in batched(items):
            link = ua.SetTriggeringRequest()
            link.Parameters = ua.SetTriggeringParameters(number, trigger, list(some), [])
            await peer.call(link, ua.SetTriggeringResponse)
    await publishing(peer, until)


async def delete_subscriptions(url, until):
    """Fill a subscription and delete it."""
    peer, number = await ready(url)
    while time.monotonic() < until:
        await filled(peer, number)
        request = ua.DeleteSubscriptionsRequest()
        request.Parameters.SubscriptionIds = [number]
        await peer.call(request, ua.DeleteSubscriptionsResponse)
        number = await subscribed(peer)


async def close_session(url, until):
    """Fill a subscription and leave."""
    while time.monotonic() < until:
        peer, number = await ready(url)
        await filled(peer, number)
        await peer.call(ua.CloseSessionRequest(DeleteSubscriptions=True), ua.CloseSessionResponse)
        peer.close()


async def delete_items(url, until):
    """Delete a thousand items of ten thousand, and create them again."""
    peer, number = await ready(url)
    while time.monotonic() < until:
        for some in batched(await filled(peer, number)):
            request = ua.DeleteMonitoredItemsRequest()
            request.Parameters = ua.DeleteMonitoredItemsParameters(number, list(some))
            await peer.call(request, ua.DeleteMonitoredItemsResponse)


async def set_modes(url, until):
    """Switch a thousand items off and on."""
    peer, number = await ready(url)
    items = await filled(peer, number)
    while time.monotonic() < until:
        for mode in (Mode.Disabled, Mode.Reporting):
            request = ua.SetMonitoringModeRequest()
            request.Parameters = ua.SetMonitoringModeParameters(number, mode, items[:AT_ONCE])
            await peer.call(request, ua.SetMonitoringModeResponse)


async def modify_items(url, until):
    """Modify a thousand items."""
    peer, number = await ready(url)
    items = await filled(peer, number)
    request = ua.ModifyMonitoredItemsRequest()
    changes = [ua.MonitoredItemModifyRequest(item, WISH) for item in items[:AT_ONCE]]
    request.Parameters = ua.ModifyMonitoredItemsParameters(number, BOTH, changes)
    while time.monotonic() < until:
        await peer.call(request, ua.ModifyMonitoredItemsResponse)


async def resend(url, until):
    """Ask for all current values again."""
    peer, number = await ready(url)
    await filled(peer, number)
    while time.monotonic() < until:
        await called(peer, Ids.Server_ResendData, number, 1)


async def get_items(url, until):
    """Ask a hundred times at once which items there are."""
    peer, number = await ready(url)
    await filled(peer, number)
    while time.monotonic() < until:
        with contextlib.suppress(ua.UaError):
            await called(peer, Ids.Server_GetMonitoredItems, number, 100)


async def wildcard_paths(url, until):
    """Follow paths that lead everywhere."""
    peer = await (await RawPeer.connect(url)).log_in()
    anywhere = ua.RelativePathElement(IncludeSubtypes=True)
    named = ua.RelativePathElement(TargetName=ua.QualifiedName("nowhere"), IncludeSubtypes=True)
    request = ua.TranslateBrowsePathsToNodeIdsRequest()
    path = ua.BrowsePath(ua.NodeId(Ids.RootFolder), ua.RelativePath([anywhere] * 4 + [named]))
    request.Parameters.BrowsePaths = [path] * 50
    while time.monotonic() < until:
        await peer.call(request, ua.TranslateBrowsePathsToNodeIdsResponse)


async def changing_values(url, until):
    """Ten sessions watch every changing value as often as they may, and read all of it."""
    peers = [await ready(url) for _ in range(10)]
    items = [created(node, ua.AttributeIds.Value, Mode.Reporting) for node in SINGLES] * 5
    for peer, number in peers:
        for some in batched(items):
            request = ua.CreateMonitoredItemsRequest()
            request.Parameters = ua.CreateMonitoredItemsParameters(number, BOTH, list(some))
            await peer.call(request, ua.CreateMonitoredItemsResponse)
    await asyncio.gather(*(publishing(peer, until) for peer, _ in peers))


async def saved_up(url, until):
    """Let twenty subscriptions save up all that they may, then ask for it at a stretch."""
    peer = await (await RawPeer.connect(url)).log_in()
    numbers = [await subscribed(peer) for _ in range(20)]
    for number, nodes in zip(numbers, itertools.cycle(batched(SINGLES, 50)), strict=False):
        items = [created(node, ua.AttributeIds.Value, Mode.Reporting) for node in nodes]
        request = ua.CreateMonitoredItemsRequest()
        request.Parameters = ua.CreateMonitoredItemsParameters(number, BOTH, items)
        await peer.call(request, ua.CreateMonitoredItemsResponse)
    await asyncio.sleep(0.6 * (until - time.monotonic()))
    await publishing(peer, until)


async def register_nodes(url, until):
    """Register a thousand nodes with the longest names there may be."""
    peer = await (await RawPeer.connect(url)).log_in()
    request = ua.RegisterNodesRequest()
    request.Parameters.NodesToRegister = [ua.NodeId("x" * 400, 2)] * AT_ONCE
    while time.monotonic() < until:
        await peer.call(request, ua.RegisterNodesResponse)


async def writes(url, until):
    """Write a thousand times what may not be written."""
    peer = await (await RawPeer.connect(url)).log_in()
    request = ua.WriteRequest()
    value = ua.DataValue(ua.Variant(1, ua.VariantType.UInt32))
    item = ua.WriteValue(COUNTER, ua.AttributeIds.Value, None, value)
    request.Parameters.NodesToWrite = [item] * AT_ONCE
    while time.monotonic() < until:
        await peer.call(request, ua.WriteResponse)


async def sessions_full(url, until):
    """Hold the limit of sessions and subscriptions."""
    peers = []
    with contextlib.suppress(Exception):
        while True:
            peer = await (await RawPeer.connect(url)).log_in()
            peers.append(peer)
            with contextlib.suppress(ua.UaError):
                while True:
                    await subscribed(peer)
    await asyncio.sleep(until - time.monotonic())


BOTH = ua.TimestampsToReturn.Both


async def ready(url):
    """Return a peer that is logged in, and its subscription."""
    peer = await (await RawPeer.connect(url)).log_in()
    return peer, await subscribed(peer)


async def subscribed(peer):
    parameters = ua.CreateSubscriptionParameters(50.0, 10_000, 1_000, 0, True, 0)  # noqa: FBT003
    request = ua.CreateSubscriptionRequest(Parameters=parameters)
    return (await peer.call(request, ua.CreateSubscriptionResponse)).Parameters.SubscriptionId


async def filled(peer, number, mode=Mode.Reporting):
    """Monitor as many attributes of standard nodes as one subscription may."""
    wanted = [
        created(ua.NodeId(node), attribute, mode)
        for attribute in _ATTRIBUTES
        for node in sorted(v for k, v in vars(Ids).items() if isinstance(v, int))[:6_000]
    ]
    found = []
    for some in batched(wanted):
        request = ua.CreateMonitoredItemsRequest()
        request.Parameters = ua.CreateMonitoredItemsParameters(number, BOTH, list(some))
        results = (await peer.call(request, ua.CreateMonitoredItemsResponse)).Results
        found += [result.MonitoredItemId for result in results if result.StatusCode.is_good()]
        if len(found) >= ITEMS:
            break
    return found


def created(node, attribute, mode):
    return ua.MonitoredItemCreateRequest(ua.ReadValueId(node, attribute), mode, WISH)


async def called(peer, method, number, times):
    request = ua.CallRequest()
    one = ua.CallMethodRequest(
        ua.NodeId(Ids.Server), ua.NodeId(method), [ua.Variant(number, ua.VariantType.UInt32)]
    )
    request.Parameters.MethodsToCall = [one] * times
    await peer.call(request, ua.CallResponse)


async def publishing(peer, until):
    """Ask for notifications and read them, as fast as they come."""
    while time.monotonic() < until:
        for _ in range(20):
            peer.send(ua.PublishRequest())
        await asyncio.wait_for(peer.writer.drain(), 1.0)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(0.05):
                if not await peer.reader.read(1_000_000):
                    raise ConnectionError


def batched(items, size=AT_ONCE):
    items = iter(items)
    while some := tuple(itertools.islice(items, size)):
        yield some


WORST = {
    load.__name__: load
    for load in (
        triggering,
        delete_subscriptions,
        close_session,
        delete_items,
        set_modes,
        modify_items,
        resend,
        get_items,
        wildcard_paths,
        changing_values,
        saved_up,
        register_nodes,
        writes,
        sessions_full,
    )
}
