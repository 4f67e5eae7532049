"""One subscription, its publish requests, and the buffer of what they brought.

Several publish requests are in flight; responses are taken in the order of their arrival.
A gap in the sequence numbers is asked for again (Republish) before what comes after it is
handed on. Every response is acknowledged with the next request.
"""

import asyncio
import math
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain, repeat

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from guarded_opcua.logs import bounded_logger
from valvemap.clock import Clock
from valvemap.errors import SourceError, SourceLost
from valvemap.opcua_client.connection import Connection, status_name
from valvemap.opcua_client.responses import Senseless
from valvemap.opcua_source.decoding import (
    DecodeError,
    Message,
    PublishResponse,
    decode_publish_response,
    decode_republish_response,
)
from valvemap.opcua_source.monitored_items import Item, create_items, delete_items, enlarge_queues
from valvemap.opcua_source.source_nodes import MonitoredNode
from valvemap.pipeline.data_changes import DataChanges

_log = bounded_logger(__name__)

_STALL_S = 1.0  # a wait that lasts so much too long shows our own standstill
_LOST_KEEP_ALIVES = 3
_LONGEST_ANSWER_S = 1.5  # on top of them
_LIFETIME_KEEP_ALIVES = 10
LIFETIME_S = 120.0
QUEUED_S = 60.0  # of samples that the server shall keep while the line is cut
_NOTICEABLY = 1.1  # larger must a queue be to be asked for
_MEASURE_S = 2.0
_SPARE = 1.2  # of a queue, for a source that is a little faster than it was measured
_MEASURE_AFTER_S = (2.0, 10.0, 60.0)  # … then as often as the last
_MAX_REPUBLISH = 100
_MOST_KEPT_BACK = 10_000  # messages; no server keeps so many
_LONGEST_SILENCE_S = 86_400.0  # whoever may be silent for longer cannot be watched
_NOTIFICATIONS_PER_PUBLISH = 100_000
_MOST_CHANGES = 2 * _NOTIFICATIONS_PER_PUBLISH  # some servers count generously
_GOOD_TRANSFERRED = 0x002D0000


@dataclass
class Tally:
    """What was seen so far; grows over all connections."""

    notifications: int = 0
    publish_responses: int = 0
    missing_messages: int = 0
    overflows: int = 0
    undecodable: int = 0
    from_history: int = 0


@dataclass(frozen=True)
class Part:
    """What one message brought: the changes, which message, and what is known to be lost before.

    ``behind_gap``: messages before it never came; ``overflows``: queues at the server were full.
    """

    changes: DataChanges
    subscription: int
    message: int
    behind_gap: bool
    overflows: int


@dataclass(frozen=True)
class Left:
    """A subscription that was left alone at the server, as far as it was heard.

    Attributes
    ----------
    created
        What the server said of it.
    next_message
        Sequence number of the message to come; None before the first.
    acknowledgements
        What was to be acknowledged.
    buffer
        What nobody has taken yet.
    items
        The monitored items: node, number at the server, queue granted.
    kept_back
        Messages that are not to be acknowledged before they are committed; None: all may be.
    behind_gap
        Whether messages before the next one never came.
    """

    created: ua.CreateSubscriptionResult
    next_message: int | None
    acknowledgements: tuple[ua.SubscriptionAcknowledgement, ...]
    buffer: tuple[Part, ...]
    items: tuple[Item, ...]
    kept_back: tuple[int, ...] | None = None
    behind_gap: bool = False


class Subscription:
    """A running subscription; made by :func:`subscribe` or :func:`take_over`."""

    def __init__(
        self,
        connection: Connection,
        created: ua.CreateSubscriptionResult,
        tally: Tally,
        clock: Clock,
    ) -> None:
        self._created = created
        self._items: tuple[Item, ...] = ()
        self._item_of_handle: NDArray[np.int32] | None = None  # None: they are the same
        self._asked = 0
        self._tidies = False
        self._kept_back: deque[int] | None = None  # messages that nobody has committed yet
        self._behind_gap = False
        self._counted: NDArray[np.int64] | None = None  # changes by item, while they are measured
        self._connection = connection
        self._session = connection.session
        self._settings = connection.settings
        self._id = created.SubscriptionId
        self._interval_s = created.RevisedPublishingInterval * 1e-3
        self._tally = tally
        self._clock = clock
        silent_s = _LOST_KEEP_ALIVES * created.RevisedMaxKeepAliveCount * self._interval_s
        self._silence = silent_s + min(connection.settings.timeout_s, _LONGEST_ANSWER_S)
        self._heard = clock.monotonic()
        self._next: int | None = None
        self._acknowledgements: list[ua.SubscriptionAcknowledgement] = []
        self._in_turn = asyncio.Lock()
        self._buffer: list[Part] = []
        self._buffered = 0
        self._arrived = asyncio.Event()
        self._room = asyncio.Event()
        self._room.set()
        self._failure: SourceError | None = None
        self._publishers: set[asyncio.Task[None]] = set()

    def left(self) -> Left:
        """What another connection needs to go on with it; its buffer is empty then."""
        buffer = tuple(self._buffer)
        self._buffer.clear()
        self._buffered = 0
        return Left(
            self._created,
            self._next,
            tuple(self._acknowledgements),
            buffer,
            self._items,
            None if self._kept_back is None else tuple(self._kept_back),
            self._behind_gap,
        )

    def go_on_from(self, left: Left) -> None:
        """Begin where another one was left."""
        self._next = left.next_message
        self._acknowledgements = list(left.acknowledgements)
        self.watch(left.items)
        self._tidies = True
        if left.kept_back is not None:
            self._kept_back = deque(left.kept_back, _MOST_KEPT_BACK)
        self._behind_gap = left.behind_gap

    def hold_back(self) -> None:
        """Acknowledge from now on only what `commit` says."""
        self._kept_back = deque(maxlen=_MOST_KEPT_BACK)

    @property
    def created(self) -> ua.CreateSubscriptionResult:
        """What the server said of it."""
        return self._created

    @property
    def items(self) -> tuple[Item, ...]:
        """Its monitored items."""
        return self._items

    def commit(self, subscription: int, message: int) -> None:
        """What was handed out up to a message need not be had again."""
        if self._kept_back is None or subscription != self._id:
            return
        while self._kept_back and (message - self._kept_back[0]) % 2**32 < 2**31:
            number = self._kept_back.popleft()
            self._acknowledgements.append(_acknowledgement(self._id, number))

    def watch(self, items: Sequence[Item]) -> None:
        """See to it from now on that the queues of these items hold what they must."""
        self._items = tuple(items)
        self._item_of_handle = _items_by_handle(self._items)

    async def change_items(self, nodes: Sequence[MonitoredNode], surplus: Sequence[int]) -> None:
        """Watch just these nodes: some more than before, and the surplus items no longer.

        Raises
        ------
        SourceLost, SourceRejected
        """
        watched = {item.node.item for item in self._items}
        handle = max((item.handle for item in self._items), default=-1) + 1
        missing = [node for node in nodes if node.item not in watched]
        with self._connection.errors("changing what is subscribed to"):
            if surplus:
                await delete_items(self._connection, self._id, surplus)
            if missing:
                by_handle = dict(enumerate(missing, handle))
                added = await create_items(self._connection, self._id, by_handle)
                self.watch((*self._items, *added))

    async def catch_up(self, available: Sequence[int] = ()) -> bool:
        """Ask for all messages again that were sent over the connection before.

        Returns
        -------
        bool
            False if the server does not know the subscription any more.

        Raises
        ------
        SourceLost
        """
        with self._connection.errors("taking the subscription over"):
            try:
                self._skip_to_oldest(available)
                message = await self._republish(self._next or 1)
                while message is not None and message.sequence_number == (self._next or 1):
                    self._accept(message)
                    message = await self._republish(self._next or 1)
            except ua.uaerrors.BadSubscriptionIdInvalid:
                return False
            except ua.uaerrors.BadServiceUnsupported:
                return True
        return True

    def start(self) -> None:
        """Send the first publish requests."""
        self._publishers.add(asyncio.create_task(self._adapt_queues()))
        for _ in range(self._settings.publish_requests):
            self._publishers.add(asyncio.create_task(self._publish_until_it_fails()))

    async def receive(self) -> list[Part]:
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
        parts, self._buffer = self._buffer, []
        self._buffered = 0
        if not self._room.is_set():
            self._heard = self._clock.monotonic()  # it was we who were silent
            self._room.set()
        return parts

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
        if self._tidies:
            self._tidy(response)
        await self._fill_gap(response)
        message = response.message
        if message.keep_alive or self._came_before(message):
            return
        self._accept(message)
        if message.status_change is not None and (
            message.status_change >> 30 or message.status_change == _GOOD_TRANSFERRED
        ):
            name = status_name(message.status_change)
            self._fail(SourceLost(f"{self._settings.url}: the subscription ended: {name}"))

    def _tidy(self, response: PublishResponse) -> None:
        """Acknowledge what was to be over the connection before."""
        self._tidies = False
        known = {ack.SequenceNumber for ack in self._acknowledgements} | set(self._kept_back or ())
        for number in response.available:
            heard = self._next is not None and 0 < (self._next - number) % 2**32 < 2**31
            if heard and number not in known:
                self._acknowledge(number)

    def _came_before(self, message: Message) -> bool:
        return self._next is not None and message.sequence_number != self._next

    def _accept(self, message: Message) -> None:
        """Take a message in; whatever happens then, it is not asked for again."""
        self._keep(message)
        self._acknowledge(message.sequence_number)
        self._next = _after(message.sequence_number)

    async def _fill_gap(self, response: PublishResponse) -> None:
        """Ask again for what lies between the last message and this one."""
        number = response.message.sequence_number
        if self._next is None:
            self._next = number
        gap = (number - self._next) % 2**32
        if gap >= 2**31:
            _log.warning("%s: message %d came twice", self._settings.url, number)
            self._acknowledge(number)
            return
        beyond = max(gap - _MAX_REPUBLISH, 0)
        for _ in range(gap - beyond):
            message = await self._republish(self._next)
            if message is None or message.sequence_number != self._next:
                self._miss(1)
                self._next = _after(self._next)
            else:
                self._accept(message)
        self._miss(beyond)
        self._next = number

    def _miss(self, messages: int) -> None:
        self._tally.missing_messages += messages
        self._behind_gap |= messages > 0

    async def _republish(self, number: int) -> Message | None:
        request = ua.RepublishRequest()
        request.Parameters.SubscriptionId = self._id
        request.Parameters.RetransmitSequenceNumber = number
        try:
            return decode_republish_response(await self._session.request(request))
        except DecodeError as error:
            raise Senseless(f"a message again that is not understood: {error}") from error
        except (
            ua.uaerrors.BadMessageNotAvailable,
            ua.uaerrors.BadServiceUnsupported,
            TimeoutError,
        ):
            return None

    def _skip_to_oldest(self, available: Sequence[int]) -> None:
        """Go on with the oldest message that the server still has."""
        begin = self._next or 1
        ahead = sorted((n - begin) % 2**32 for n in available)
        ahead = [steps for steps in ahead if steps < 2**31]
        if ahead and ahead[0]:
            self._miss(ahead[0])
            self._next = _ahead(begin, ahead[0])

    def _acknowledge(self, number: int) -> None:
        if self._kept_back is not None:
            self._kept_back.append(number)
        else:
            self._acknowledgements.append(_acknowledgement(self._id, number))

    def _keep(self, message: Message) -> None:
        changes = self._of_items(message.changes)
        if not len(changes):
            return
        if len(changes) > _MOST_CHANGES:
            raise Senseless(
                f"{len(changes)} changes at once, {_NOTIFICATIONS_PER_PUBLISH} were asked"
            )
        self._tally.notifications += len(changes)
        self._tally.overflows += message.overflows
        self._tally.undecodable += message.not_numeric
        if self._counted is not None:
            self._counted += np.bincount(
                np.clip(changes.item, 0, len(self._counted) - 1), minlength=len(self._counted)
            )
        number = message.sequence_number
        part = Part(changes, self._id, number, self._behind_gap, message.overflows)
        self._behind_gap = False
        self._buffer.append(part)
        self._buffered += len(changes)
        if self._buffered >= self._settings.buffer_limit:
            self._room.clear()
        self._arrived.set()

    def _of_items(self, changes: DataChanges) -> DataChanges:
        """The changes that are ours, marked by item instead of handle."""
        table = self._item_of_handle
        if table is None or not len(changes):
            return changes
        known = (changes.item >= 0) & (changes.item < len(table))
        item = np.where(known, table[np.where(known, changes.item, 0)], np.int32(-1))
        return replace(changes, item=item)[item >= 0]

    async def _adapt_queues(self) -> None:
        """Measure how fast nodes change, and have queues that hold a minute of it."""
        for pause_s in chain(_MEASURE_AFTER_S, repeat(_MEASURE_AFTER_S[-1])):
            await asyncio.sleep(pause_s - _MEASURE_S)
            if not self._items:
                continue
            self._counted = np.zeros(1 + max(item.node.item for item in self._items), np.int64)
            began = self._clock.monotonic()
            await asyncio.sleep(_MEASURE_S)
            passed, counted = self._clock.monotonic() - began, self._counted
            self._counted = None
            wanted = math.ceil(_SPARE * QUEUED_S * int(counted.max()) / passed)
            with suppress(SourceError):  # publishing says so, too
                await self._have_queues_of(wanted)

    async def _have_queues_of(self, size: int) -> None:
        if size <= _NOTICEABLY * max(self._settings.queue_size, self._asked):
            return
        self._asked = size
        with self._connection.errors("enlarging queues"):
            self._items = await enlarge_queues(self._connection, self._id, self._items, size)
        _log.info("%s: queues of %d values asked for", self._settings.url, size)

    def _fail(self, error: SourceError) -> None:
        self._failure = self._failure or error
        self._arrived.set()


async def subscribe(
    connection: Connection,
    nodes: Sequence[MonitoredNode],
    tally: Tally,
    clock: Clock,
    *,
    hold_back: bool = False,
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
                    _LIFETIME_KEEP_ALIVES * keep_alive, round(LIFETIME_S * 1e3 / interval)
                ),
                RequestedMaxKeepAliveCount=keep_alive,
                MaxNotificationsPerPublish=_NOTIFICATIONS_PER_PUBLISH,
                PublishingEnabled=True,
            )
        )
        _check_pace(result)
    subscription = Subscription(connection, result, tally, clock)
    if hold_back:
        subscription.hold_back()
    subscription.start()
    try:
        with connection.errors("subscribing"):
            by_handle = {node.item: node for node in nodes}
            items = await create_items(connection, result.SubscriptionId, by_handle)
        subscription.watch(items)
    except BaseException:
        await subscription.stop()
        raise
    return subscription


async def take_over(
    connection: Connection, left: Left, tally: Tally, clock: Clock
) -> tuple[Subscription, Sequence[int]] | None:
    """Take over a subscription that was left at the server; None if it gives it to us no more.

    It is to catch up from what is ``available``, and to be started then.

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
    subscription = Subscription(connection, left.created, tally, clock)
    subscription.go_on_from(left)
    return subscription, available


def _items_by_handle(items: Sequence[Item]) -> NDArray[np.int32] | None:
    if all(item.handle == item.node.item for item in items):
        return None
    table = np.full(1 + max(item.handle for item in items), -1, np.int32)
    for item in items:
        table[item.handle] = item.node.item
    return table


def _check_pace(created: ua.CreateSubscriptionResult) -> None:
    """Refuse a revised publishing that would keep us busy, or waiting, for ever."""
    interval_ms, count = created.RevisedPublishingInterval, created.RevisedMaxKeepAliveCount
    silence_ms = _LOST_KEEP_ALIVES * count * interval_ms
    if not (interval_ms > 0.0 and count and silence_ms <= _LONGEST_SILENCE_S * 1e3):
        raise ValueError(f"keep-alives every {count} times {interval_ms:g} ms")


def _acknowledgement(subscription: int, number: int) -> ua.SubscriptionAcknowledgement:
    return ua.SubscriptionAcknowledgement(SubscriptionId=subscription, SequenceNumber=number)


def _after(number: int) -> int:
    """Sequence numbers run from 1 to 2**32 - 1 and begin anew (Part 4, 7.8)."""
    return number + 1 if number < 2**32 - 1 else 1


def _ahead(number: int, steps: int) -> int:
    for _ in range(steps):
        number = _after(number)
    return number
