"""A subscription to variables of one of our servers.

A message costs a server far more than the values in it. So the sampling interval is short and the
publishing interval long: no change is lost, at the cost of a short delay.
"""

import asyncio
from collections import deque
from collections.abc import Mapping, Sequence
from itertools import count
from typing import Any, Generic, TypeVar

from asyncua import ua

from valvemap.errors import SourceError, SourceLost, SourceRejected
from valvemap.opcua_client.connection import Connection
from valvemap.opcua_client.requests import in_chunks, operation_limits
from valvemap.opcua_client.responses import decode_response
from valvemap.opcua_client.sampling import CLOSELY, Sampling, sampled_item
from valvemap.opcua_client.source_errors import status_name

_Name = TypeVar("_Name")
_Item = TypeVar("_Item")

_KEEP_ALIVES, _LIFETIME = 20, 120  # publishing intervals: of 0.5 s, 10 and 60 s
_VALUES_PER_MESSAGE = 500
_MOST_CHANGES = 10_000  # buffered until take(); the oldest are dropped first
_MOST_EVENTS = 5_000  # buffered until take_events(); the oldest are dropped first
_EVENT_QUEUE = 1_000  # at the server, until they are published


"""Twice the fastest update rate of any client, so no update is lost; the queue holds 2 s."""


class Followed(Generic[_Name]):
    """One subscription: created by the first :meth:`follow` or :meth:`listen`.

    It is deleted by :meth:`stop`, or when nothing is followed and no events are listened to.

    Attributes
    ----------
    lost : int
        Changes and events dropped because a buffer was full.
    """

    def __init__(self, connection: Connection) -> None:
        self.lost = 0
        self._connection = connection
        self._subscription: int | None = None
        self._publishing: asyncio.Task[None] | None = None
        self._handles = count(1)
        self._names: dict[int, _Name] = {}  # by client handle
        self._items: dict[_Name, int] = {}  # numbers at the server
        self._changes: deque[tuple[_Name, ua.DataValue]] = deque(maxlen=_MOST_CHANGES)
        self._failure: SourceError | None = None
        self._listening: int | None = None  # client handle of the item for events
        self._events: deque[list[Any]] = deque(maxlen=_MOST_EVENTS)

    async def listen(self, node: ua.NodeId, wanted: ua.EventFilter, every_s: float) -> int:
        """Monitor the events of a node beside the values; return the subscription's number.

        Raises
        ------
        SourceRejected
            if the server accepts no more subscriptions or items.
        SourceLost
        """
        with self._connection.errors("listening to events"):
            await self._begin(every_s)
            handle = next(self._handles)
            item = ua.MonitoredItemCreateRequest(
                ItemToMonitor=ua.ReadValueId(
                    NodeId=node, AttributeId=ua.AttributeIds.EventNotifier
                ),
                MonitoringMode=ua.MonitoringMode.Reporting,
                RequestedParameters=ua.MonitoringParameters(
                    ClientHandle=handle, Filter=wanted, QueueSize=_EVENT_QUEUE, DiscardOldest=True
                ),
            )
            self._listening = handle
            (result,) = await self._create([item])
        if result.StatusCode.value >> 30:
            self._listening = None
            url, why = self._connection.settings.url, status_name(result.StatusCode.value)
            raise SourceRejected(f"{url}: {why}")
        return self._subscription or 0

    def take_events(self) -> list[list[Any]]:
        """Return the selected fields of the buffered events, and empty the buffer.

        Raises
        ------
        SourceLost, SourceRejected
            the failure that ended the subscription.
        """
        return self._emptied(self._events)

    async def follow(
        self, nodes: Mapping[_Name, ua.NodeId], every_s: float, sampling: Sampling = CLOSELY
    ) -> None:
        """Monitor exactly these nodes: add the missing items and delete the others.

        ``every_s`` is the publishing interval; it is fixed by the call that creates the
        subscription.

        Raises
        ------
        SourceRejected
            if the server accepts no more subscriptions or items; no node is monitored then.
        SourceLost
        """
        if not nodes:
            await self._end_values()
            return
        try:
            with self._connection.errors("following values"):
                await self._begin(every_s)
                await self._forget([name for name in self._items if name not in nodes])
                new = {n: node for n, node in nodes.items() if n not in self._items}
                await self._add(new, sampling)
        except SourceRejected:
            await self._end_values()
            raise

    def take(self) -> list[tuple[_Name, ua.DataValue]]:
        """Return the buffered changes in order of arrival, and empty the buffer.

        Raises
        ------
        SourceLost, SourceRejected
            the failure that ended the subscription.
        """
        return self._emptied(self._changes)

    async def stop(self) -> None:
        """Delete the subscription at the server.

        Raises
        ------
        SourceLost, SourceRejected
        """
        number, self._subscription = self._subscription, None
        self._listening = None
        self._items.clear()
        self._names.clear()
        self._changes.clear()
        self._events.clear()
        self._failure = None
        if number is None or self._publishing is None:
            return
        with self._connection.errors("ending the followed subscriptions"):
            await self._connection.session.end_subscription(number)
            async with asyncio.timeout(self._connection.settings.timeout_s):
                await self._publishing  # its request now fails with BadNoSubscription
        self._publishing = None

    async def end(self) -> None:
        """Cancel publishing without a request to the server: the connection is closed."""
        if self._publishing is not None:
            self._publishing.cancel()
            await asyncio.gather(self._publishing, return_exceptions=True)

    def _emptied(self, buffer: deque[_Item]) -> list[_Item]:
        if self._failure is not None:
            raise self._failure
        found = list(buffer)
        buffer.clear()
        return found

    async def _end_values(self) -> None:
        """Monitor no values any more; the subscription stays for events."""
        if self._listening is None:
            await self.stop()
            return
        with self._connection.errors("ending followed values"):
            await self._forget(list(self._items))
        self._changes.clear()

    async def _begin(self, every_s: float) -> None:
        if self._subscription is not None:
            return
        wished = ua.CreateSubscriptionParameters(
            RequestedPublishingInterval=every_s * 1e3,
            RequestedLifetimeCount=_LIFETIME,
            RequestedMaxKeepAliveCount=_KEEP_ALIVES,
            MaxNotificationsPerPublish=_VALUES_PER_MESSAGE,
            PublishingEnabled=True,
        )
        try:
            created = await self._connection.session.create_subscription(wished)
        except ua.uaerrors.BadTooManySubscriptions as error:
            raise SourceRejected(f"{self._connection.settings.url}: {error}") from error
        self._subscription = created.SubscriptionId
        self._publishing = asyncio.create_task(self._publish(created.SubscriptionId))

    async def _add(self, nodes: Mapping[_Name, ua.NodeId], sampling: Sampling) -> None:
        if not nodes:
            return
        handles = {next(self._handles): name for name in nodes}
        self._names |= handles
        items = [sampled_item(nodes[name], handle, sampling) for handle, name in handles.items()]
        limit = (await operation_limits(self._connection)).items_per_call
        results = await in_chunks(items, limit, self._create)
        for (handle, name), result in zip(handles.items(), results, strict=True):
            code = result.StatusCode.value
            if not code >> 30:
                self._items[name] = result.MonitoredItemId
            elif code == ua.StatusCodes.BadNodeIdUnknown:
                del self._names[handle]  # it can never change
            else:
                raise SourceRejected(f"{self._connection.settings.url}: {status_name(code)}")

    async def _create(
        self, items: Sequence[ua.MonitoredItemCreateRequest]
    ) -> list[ua.MonitoredItemCreateResult]:
        return await self._connection.session.create_monitored_items(
            ua.CreateMonitoredItemsParameters(
                SubscriptionId=self._subscription,
                TimestampsToReturn=ua.TimestampsToReturn.Source,
                ItemsToCreate=list(items),
            )
        )

    async def _forget(self, names: list[_Name]) -> None:
        if not names:
            return
        numbers = [self._items.pop(name) for name in names]
        self._names = {handle: name for handle, name in self._names.items() if name in self._items}
        await self._connection.session.delete_monitored_items(
            ua.DeleteMonitoredItemsParameters(self._subscription, numbers)
        )

    async def _publish(self, subscription: int) -> None:
        acknowledged: list[ua.SubscriptionAcknowledgement] = []
        try:
            with self._connection.errors("following values"):
                while True:
                    request = ua.PublishRequest()
                    request.Parameters.SubscriptionAcknowledgements = acknowledged
                    body = await self._connection.session.request(request, timeout=0)
                    answer = decode_response(ua.PublishResponse, body).Parameters
                    acknowledged = []
                    if answer.NotificationMessage.NotificationData:
                        number = answer.NotificationMessage.SequenceNumber
                        acknowledged.append(ua.SubscriptionAcknowledgement(subscription, number))
                        self._keep(answer.NotificationMessage.NotificationData)
        except SourceError as error:
            self._failure = error if self._subscription == subscription else None

    def _keep(self, notifications: list[object]) -> None:
        for notification in notifications:
            match notification:
                case ua.DataChangeNotification(MonitoredItems=changes):
                    for change in changes:
                        name = self._names.get(change.ClientHandle)
                        if name is not None:
                            self.lost += len(self._changes) == _MOST_CHANGES
                            self._changes.append((name, change.Value))
                case ua.EventNotificationList(Events=events):
                    for event in events:
                        if event.ClientHandle == self._listening:
                            self.lost += len(self._events) == _MOST_EVENTS
                            self._events.append([field.Value for field in event.EventFields])
                case ua.StatusChangeNotification(Status=status) if status.value >> 30:
                    url, why = self._connection.settings.url, status_name(status.value)
                    raise SourceLost(f"{url}: the subscription ended: {why}")
