"""One subscription, its publish requests, and the buffer of what they brought.

Several publish requests are in flight; responses are taken in the order of their arrival.
A gap in the sequence numbers is asked for again (Republish) before what comes after it is
handed on. Every response is acknowledged with the next request.
"""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass

from asyncua import ua

from service.clock import Clock
from service.errors import SourceError, SourceLost, SourceRejected
from service.hardened.logs import bounded_logger
from service.opcua.connection import Connection, status_name
from service.opcua.decoding import (
    DecodeError,
    Message,
    PublishResponse,
    decode_publish_response,
    decode_republish_response,
)
from service.opcua.responses import Senseless
from service.opcua.source_nodes import MonitoredNode, in_chunks, operation_limits
from service.streaming.data_changes import SIGNALS_PER_VALVE, DataChanges

_log = bounded_logger(__name__)

_STALL_S = 1.0  # a wait that lasts so much too long tells of our own standstill
_LOST_KEEP_ALIVES = 3
_LIFETIME_KEEP_ALIVES = 10
_LIFETIME_S = 60.0
_MAX_REPUBLISH = 100
_LONGEST_SILENCE_S = 86_400.0  # whoever may be silent for longer cannot be watched
_NOTIFICATIONS_PER_PUBLISH = 100_000
_MOST_CHANGES = 2 * _NOTIFICATIONS_PER_PUBLISH  # some servers count generously
_ITEMS_AT_ONCE = 20 * SIGNALS_PER_VALVE  # between two requests the server publishes
_GOOD_TRANSFERRED = 0x002D0000


@dataclass
class Tally:
    """What was seen so far; grows over all connections."""

    notifications: int = 0
    publish_responses: int = 0
    missing_messages: int = 0
    overflows: int = 0
    undecodable: int = 0


class Subscription:
    """A running subscription; made by :func:`subscribe`."""

    def __init__(
        self,
        connection: Connection,
        created: ua.CreateSubscriptionResult,
        tally: Tally,
        clock: Clock,
    ) -> None:
        self._connection = connection
        self._session = connection.session
        self._settings = connection.settings
        self._id = created.SubscriptionId
        self._interval_s = created.RevisedPublishingInterval * 1e-3
        self._tally = tally
        self._clock = clock
        silent_s = _LOST_KEEP_ALIVES * created.RevisedMaxKeepAliveCount * self._interval_s
        self._silence = silent_s + connection.settings.timeout_s
        self._heard = clock.monotonic()
        self._next: int | None = None
        self._acknowledgements: list[ua.SubscriptionAcknowledgement] = []
        self._in_turn = asyncio.Lock()
        self._buffer: list[DataChanges] = []
        self._buffered = 0
        self._arrived = asyncio.Event()
        self._room = asyncio.Event()
        self._room.set()
        self._failure: SourceError | None = None
        self._publishers: set[asyncio.Task[None]] = set()

    def start(self) -> None:
        """Send the first publish requests."""
        for _ in range(self._settings.publish_requests):
            self._publishers.add(asyncio.create_task(self._publish_until_it_fails()))

    async def receive(self) -> DataChanges:
        """Wait for changes and take all there are; a failure comes after them."""
        listening = self._clock.monotonic()  # before, it was we who were silent
        while not self._buffer:
            if self._failure is not None:
                raise self._failure
            now = self._clock.monotonic()
            patience = max(self._heard, listening) + self._silence - now
            if patience <= 0.0:
                raise SourceLost(
                    f"{self._settings.url}: silent for {self._silence:.1f} s, "
                    f"{_LOST_KEEP_ALIVES} keep-alives are missing"
                )
            try:
                async with asyncio.timeout(patience):
                    await self._arrived.wait()
            except TimeoutError:
                if self._clock.monotonic() - now > patience + _STALL_S:
                    listening = self._clock.monotonic()
                continue
            self._arrived.clear()
        changes = DataChanges.concatenate(self._buffer)
        self._buffer.clear()
        self._buffered = 0
        if not self._room.is_set():
            self._heard = self._clock.monotonic()  # it was we who were silent
            self._room.set()
        return changes

    async def stop(self) -> None:
        """Send no more publish requests; the session's end deletes the subscription."""
        for publisher in self._publishers:
            publisher.cancel()
        await asyncio.gather(*self._publishers, return_exceptions=True)

    async def _publish_until_it_fails(self) -> None:
        try:
            with self._connection.errors("publishing"):
                await self._publish_for_ever()
        except SourceError as error:
            self._fail(error)

    async def _publish_for_ever(self) -> None:
        while True:
            await self._room.wait()
            acknowledgements, self._acknowledgements = self._acknowledgements, []
            request = ua.PublishRequest()
            request.Parameters.SubscriptionAcknowledgements = acknowledgements
            try:
                data = await self._session.request(request, timeout=0)
            except ua.uaerrors.BadTooManyPublishRequests:
                self._acknowledgements = acknowledgements + self._acknowledgements
                if len(self._publishers) > 1:
                    self._publishers = {
                        p for p in self._publishers if p is not asyncio.current_task()
                    }
                    return
                await asyncio.sleep(self._interval_s)
                continue
            except ua.uaerrors.BadTimeout:
                await asyncio.sleep(self._interval_s)
                continue
            async with self._in_turn:
                await self._take_response(data)

    async def _take_response(self, data: bytes) -> None:
        self._heard = self._clock.monotonic()
        self._tally.publish_responses += 1
        try:
            response = decode_publish_response(data)
        except DecodeError as error:
            self._tally.undecodable += 1
            raise Senseless(f"a publish response that is not understood: {error}") from error
        if response.service_result >> 31:
            raise ua.UaStatusCodeError(response.service_result)
        if response.subscription_id != self._id:
            return
        await self._fill_gap(response)
        message = response.message
        if message.keep_alive:
            return
        self._acknowledge(message.sequence_number)
        self._keep(message)
        if message.status_change is not None and (
            message.status_change >> 30 or message.status_change == _GOOD_TRANSFERRED
        ):
            name = status_name(message.status_change)
            self._fail(SourceLost(f"{self._settings.url}: the subscription ended: {name}"))

    async def _fill_gap(self, response: PublishResponse) -> None:
        """Ask again for what lies between the last message and this one."""
        number = response.message.sequence_number
        expected = number if self._next is None else self._next
        self._next = number if response.message.keep_alive else _after(number)
        gap = (number - expected) % 2**32
        if gap >= 2**31:
            _log.warning("%s: message %d came twice", self._settings.url, number)
            return
        missing = [_ahead(expected, i) for i in range(min(gap, _MAX_REPUBLISH))]
        self._tally.missing_messages += gap - len(missing)
        for lost in missing:
            message = await self._republish(lost)
            if message is None or message.sequence_number != lost:
                self._tally.missing_messages += 1
            else:
                self._acknowledge(lost)
                self._keep(message)

    async def _republish(self, number: int) -> Message | None:
        request = ua.RepublishRequest()
        request.Parameters.SubscriptionId = self._id
        request.Parameters.RetransmitSequenceNumber = number
        try:
            return decode_republish_response(await self._session.request(request))
        except DecodeError as error:
            raise Senseless(f"a message again that is not understood: {error}") from error
        except (ua.uaerrors.BadMessageNotAvailable, TimeoutError):
            return None

    def _acknowledge(self, number: int) -> None:
        self._acknowledgements.append(
            ua.SubscriptionAcknowledgement(SubscriptionId=self._id, SequenceNumber=number)
        )

    def _keep(self, message: Message) -> None:
        changes = message.changes
        if not len(changes):
            return
        if len(changes) > _MOST_CHANGES:
            raise Senseless(
                f"{len(changes)} changes at once, {_NOTIFICATIONS_PER_PUBLISH} were asked"
            )
        self._tally.notifications += len(changes)
        self._tally.overflows += message.overflows
        self._tally.undecodable += message.not_numeric
        self._buffer.append(changes)
        self._buffered += len(changes)
        if self._buffered >= self._settings.buffer_limit:
            self._room.clear()
        self._arrived.set()

    def _fail(self, error: SourceError) -> None:
        self._failure = self._failure or error
        self._arrived.set()


async def subscribe(
    connection: Connection, nodes: Sequence[MonitoredNode], tally: Tally, clock: Clock
) -> Subscription:
    """Subscribe to every sample of every node.

    The first items report while the last are still made: no queue must hold all of that time.

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
                    _LIFETIME_KEEP_ALIVES * keep_alive, round(_LIFETIME_S * 1e3 / interval)
                ),
                RequestedMaxKeepAliveCount=keep_alive,
                MaxNotificationsPerPublish=_NOTIFICATIONS_PER_PUBLISH,
                PublishingEnabled=True,
            )
        )
        _check_pace(result)
    subscription = Subscription(connection, result, tally, clock)
    subscription.start()
    try:
        with connection.errors("subscribing"):
            size = (await operation_limits(connection)).items_per_call
            created = await in_chunks(
                nodes,
                min(size, _ITEMS_AT_ONCE),
                lambda chunk: _create_items(connection, result.SubscriptionId, chunk),
            )
        _check(connection, nodes, created)
    except BaseException:
        await subscription.stop()
        raise
    return subscription


def _check_pace(created: ua.CreateSubscriptionResult) -> None:
    """Refuse a revised publishing that would keep us busy, or waiting, for ever."""
    interval_ms, count = created.RevisedPublishingInterval, created.RevisedMaxKeepAliveCount
    silence_ms = _LOST_KEEP_ALIVES * count * interval_ms
    if not (interval_ms > 0.0 and count and silence_ms <= _LONGEST_SILENCE_S * 1e3):
        raise ValueError(f"keep-alives every {count} times {interval_ms:g} ms")


async def _create_items(
    connection: Connection, subscription_id: int, nodes: Sequence[MonitoredNode]
) -> list[ua.MonitoredItemCreateResult]:
    settings = connection.settings
    created: list[ua.MonitoredItemCreateResult] = await connection.session.create_monitored_items(
        ua.CreateMonitoredItemsParameters(
            SubscriptionId=subscription_id,
            TimestampsToReturn=ua.TimestampsToReturn.Both,
            ItemsToCreate=[
                _request(node, settings.sampling_interval_ms, settings.queue_size) for node in nodes
            ],
        )
    )
    return created


def _request(
    node: MonitoredNode, sampling_interval_ms: float, queue_size: int
) -> ua.MonitoredItemCreateRequest:
    """Report every sample: a constant signal too, so the trigger looks at the timestamp."""
    return ua.MonitoredItemCreateRequest(
        ItemToMonitor=ua.ReadValueId(NodeId=node.node, AttributeId=ua.AttributeIds.Value),
        MonitoringMode=ua.MonitoringMode.Reporting,
        RequestedParameters=ua.MonitoringParameters(
            ClientHandle=node.item,
            SamplingInterval=sampling_interval_ms,
            Filter=ua.DataChangeFilter(
                Trigger=ua.DataChangeTrigger.StatusValueTimestamp,
                DeadbandType=ua.DeadbandType.None_,
            ),
            QueueSize=queue_size,
            DiscardOldest=True,
        ),
    )


def _check(
    connection: Connection,
    nodes: Sequence[MonitoredNode],
    created: Sequence[ua.MonitoredItemCreateResult],
) -> None:
    """Refuse what cannot be watched; warn of what may be lost."""
    settings = connection.settings
    for node, item in zip(nodes, created, strict=True):
        if item.StatusCode.value >> 30:
            raise SourceRejected(
                f"{node.label} cannot be subscribed to at {settings.url}: "
                f"{status_name(item.StatusCode.value)}"
            )
    smallest_queue = min(item.RevisedQueueSize for item in created)
    if smallest_queue < settings.queue_size:
        _log.warning(
            "%s: keeps %d values of a node instead of %d between two publishings",
            settings.url,
            smallest_queue,
            settings.queue_size,
        )
    slowest_ms = max(item.RevisedSamplingInterval for item in created)
    if slowest_ms > max(settings.sampling_interval_ms, 0.0):
        _log.warning(
            "%s: samples a node every %g ms instead of %g ms",
            settings.url,
            slowest_ms,
            settings.sampling_interval_ms,
        )


def _after(number: int) -> int:
    """Sequence numbers run from 1 to 2**32 - 1 and begin anew (Part 4, 7.8)."""
    return number + 1 if number < 2**32 - 1 else 1


def _ahead(number: int, steps: int) -> int:
    for _ in range(steps):
        number = _after(number)
    return number
