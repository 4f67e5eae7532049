"""Creation of a subscription, or the take-over of one that still exists at the server."""

from collections.abc import Sequence
from typing import Final

from asyncua import ua

from valvemap.clock import Clock
from valvemap.opcua_client.connection import Connection
from valvemap.opcua_source.change_buffer import LOST_KEEP_ALIVES
from valvemap.opcua_source.checked_nodes import MonitoredNode
from valvemap.opcua_source.item_table import ItemTable
from valvemap.opcua_source.monitored_items import create_items
from valvemap.opcua_source.received import Left, Tally
from valvemap.opcua_source.subscription import (
    NOTIFICATIONS_PER_PUBLISH,
    Subscription,
)

LIFETIME_S: Final = 120.0  # s; the server keeps a subscription at least as long without requests
_LIFETIME_KEEP_ALIVES = 10
_LONGEST_SILENCE_S = 86_400.0  # s; upper limit of the keep-alive watchdog


async def subscribe(
    connection: Connection,
    nodes: Sequence[MonitoredNode],
    tally: Tally,
    clock: Clock,
    table: ItemTable,
    *,
    hold_back: bool = False,
) -> Subscription:
    """Subscribe to every sample of every node.

    Publishing starts before the items are created, so queues need not hold the time that takes.

    Raises
    ------
    SourceLost, SourceRejected
    """
    settings = connection.settings
    with connection.errors("subscribing"):
        interval = settings.publishing_interval_ms
        keep_alive = max(round(settings.keep_alive_s * 1e3 / interval), 1)
        result = await connection.session.create_subscription(
            ua.CreateSubscriptionParameters(
                RequestedPublishingInterval=interval,
                RequestedLifetimeCount=max(
                    _LIFETIME_KEEP_ALIVES * keep_alive, round(LIFETIME_S * 1e3 / interval)
                ),
                RequestedMaxKeepAliveCount=keep_alive,
                MaxNotificationsPerPublish=NOTIFICATIONS_PER_PUBLISH,
                PublishingEnabled=True,
            )
        )
        _check_pace(result)
    subscription = Subscription(connection, result, tally, clock, table)
    if hold_back:
        subscription.acknowledgements.hold_back()
    subscription.watched.expect(nodes)
    subscription.start()
    try:
        with connection.errors("subscribing"):
            by_handle = {node.item: node for node in nodes}
            items = await create_items(connection, result.SubscriptionId, by_handle)
        subscription.watched.watch(items)
    except BaseException:
        await subscription.stop()
        raise
    return subscription


async def take_over(
    connection: Connection, left: Left, tally: Tally, clock: Clock, table: ItemTable
) -> tuple[Subscription, Sequence[int]] | None:
    """Take over a subscription that still exists at the server; None if it cannot be transferred.

    Returns the subscription and the sequence numbers available for Republish. Call `catch_up` with
    these, then `start`.

    Raises
    ------
    SourceLost, SourceRejected
    """
    number, available = left.created.SubscriptionId, []
    with connection.errors("taking the subscription over"):
        if not connection.resumed:
            parameters = ua.TransferSubscriptionsParameters([number], SendInitialValues=False)
            try:
                (result,) = await connection.session.transfer_subscriptions(parameters)
            except ua.UaStatusCodeError:
                return None
            if result.StatusCode.value >> 30:
                return None
            available = list(result.AvailableSequenceNumbers or ())
    subscription = Subscription(connection, left.created, tally, clock, table)
    subscription.go_on_from(left)
    return subscription, available


def _check_pace(created: ua.CreateSubscriptionResult) -> None:
    """Reject revised intervals that are zero, or too long for the keep-alive watchdog."""
    interval_ms, count = created.RevisedPublishingInterval, created.RevisedMaxKeepAliveCount
    silence_ms = LOST_KEEP_ALIVES * count * interval_ms
    if not (interval_ms > 0.0 and count and silence_ms <= _LONGEST_SILENCE_S * 1e3):
        raise ValueError(f"keep-alives every {count} times {interval_ms:g} ms")
