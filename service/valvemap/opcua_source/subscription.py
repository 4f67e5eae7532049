"""One subscription, its publish requests, and the buffer of received changes.

Several publish requests are in flight; responses are processed in order of arrival. Messages
missing in the sequence are requested again (Republish) before later ones are delivered. Every
message is acknowledged with the next request.
"""

import asyncio
from collections.abc import Sequence

from asyncua import ua

from guarded_opcua.logs import bounded_logger
from valvemap.clock import Clock
from valvemap.errors import SourceError, SourceLost
from valvemap.opcua_client.connection import Connection
from valvemap.opcua_client.responses import Senseless
from valvemap.opcua_client.source_errors import status_name
from valvemap.opcua_source.acknowledgements import Acknowledgements
from valvemap.opcua_source.change_buffer import LOST_KEEP_ALIVES, ChangeBuffer
from valvemap.opcua_source.decoding import (
    Message,
    PublishResponse,
    decode_publish_response,
    decode_republish_response,
)
from valvemap.opcua_source.item_table import ItemTable
from valvemap.opcua_source.received import Left, Part, Tally
from valvemap.opcua_source.time_order import in_order_of_time
from valvemap.opcua_source.watched_items import WatchedItems
from valvemap.opcua_source.wire import DecodeError

_log = bounded_logger(__name__)

_LONGEST_ANSWER_S = 1.5  # added to the missing keep-alives
_MAX_REPUBLISH = 100
NOTIFICATIONS_PER_PUBLISH = 100_000
_MOST_CHANGES = 2 * NOTIFICATIONS_PER_PUBLISH  # some servers exceed the limit
_GOOD_TRANSFERRED = 0x002D0000


class Subscription:
    """A running subscription; created by :mod:`valvemap.opcua_source.subscribing`.

    Attributes
    ----------
    buffer : ChangeBuffer
        Its received changes.
    watched, acknowledgements
        Its monitored items, and what is acknowledged with the next publish request.
    """

    def __init__(
        self,
        connection: Connection,
        created: ua.CreateSubscriptionResult,
        tally: Tally,
        clock: Clock,
        table: ItemTable,
    ) -> None:
        self.watched = WatchedItems(connection, created.SubscriptionId, tally, clock, table)
        self.acknowledgements = Acknowledgements(created.SubscriptionId)
        self._created = created
        self._tidies = False
        self._behind_gap = False
        self._connection = connection
        self._session = connection.session
        self._settings = connection.settings
        self._id = created.SubscriptionId
        self._interval_s = created.RevisedPublishingInterval * 1e-3
        self._tally = tally
        silent_s = LOST_KEEP_ALIVES * created.RevisedMaxKeepAliveCount * self._interval_s
        silent_s += min(connection.settings.timeout_s, _LONGEST_ANSWER_S)
        settings = connection.settings
        self.buffer = ChangeBuffer(settings.url, settings.buffer_limit, silent_s, clock)
        self._next: int | None = None
        self._in_turn = asyncio.Lock()
        self._publishers: set[asyncio.Task[None]] = set()

    def left(self) -> Left:
        """Return the state needed to resume over another connection; empties the buffer."""
        return Left(
            self._created,
            self._next,
            tuple(self.acknowledgements.unsent),
            self.buffer.take_rest(),
            self.watched.items,
            self.acknowledgements.kept_back,
            self._behind_gap,
        )

    def go_on_from(self, left: Left) -> None:
        """Start from the state of a previous connection."""
        self._next = left.next_message
        self.acknowledgements.continue_from(left.acknowledgements, left.kept_back)
        self.watched.watch(left.items)
        self._tidies = True
        self._behind_gap = left.behind_gap

    @property
    def created(self) -> ua.CreateSubscriptionResult:
        """The server's response to CreateSubscription."""
        return self._created

    @property
    def waits(self) -> bool:
        """Whether publish requests are withheld because our buffer is full."""
        return self.buffer.is_full

    async def catch_up(self, available: Sequence[int] = ()) -> bool:
        """Request all unread messages of the previous connection again (Republish).

        Returns
        -------
        bool
            False if the subscription no longer exists at the server.

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
        self._publishers.add(asyncio.create_task(self.watched.adapt_queues()))
        for _ in range(self._settings.publish_requests):
            self._publishers.add(asyncio.create_task(self._publish_until_it_fails()))

    async def stop(self) -> None:
        """Cancel publishing; closing the session deletes the subscription."""
        for publisher in self._publishers:
            publisher.cancel()
        await asyncio.gather(*self._publishers, return_exceptions=True)

    async def _publish_until_it_fails(self) -> None:
        try:
            with self._connection.errors("publishing"):
                await self._publish_for_ever()
        except SourceError as error:
            self.buffer.fail(error)

    async def _publish_for_ever(self) -> None:
        while True:
            await self.buffer.wait_for_room()
            request = ua.PublishRequest()
            sent = request.Parameters.SubscriptionAcknowledgements = self.acknowledgements.take()
            try:
                data = await self._session.request(request, timeout=0)
            except ua.uaerrors.BadTooManyPublishRequests:
                self.acknowledgements.unsent[:0] = sent
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
        self.buffer.note_response()
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
            self.buffer.fail(SourceLost(f"{self._settings.url}: the subscription ended: {name}"))

    def _tidy(self, response: PublishResponse) -> None:
        """Acknowledge received messages that the previous connection did not acknowledge."""
        self._tidies = False
        known = self.acknowledgements.known
        for number in response.available:
            heard = self._next is not None and 0 < (self._next - number) % 2**32 < 2**31
            if heard and number not in known:
                self.acknowledgements.add(number)

    def _came_before(self, message: Message) -> bool:
        return self._next is not None and message.sequence_number != self._next

    def _accept(self, message: Message) -> None:
        """Buffer a message and acknowledge it, so that it is not requested again."""
        self._keep(message)
        self.acknowledgements.add(message.sequence_number)
        self._next = _after(message.sequence_number)

    async def _fill_gap(self, response: PublishResponse) -> None:
        """Request the messages between the last one and this one again."""
        number = response.message.sequence_number
        if self._next is None:
            self._next = number
        gap = (number - self._next) % 2**32
        if gap >= 2**31:
            _log.warning("%s: message %d came twice", self._settings.url, number)
            self.acknowledgements.add(number)
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
        """Continue with the oldest message that the server still has; count skipped ones."""
        begin = self._next or 1
        ahead = sorted((n - begin) % 2**32 for n in available)
        ahead = [steps for steps in ahead if steps < 2**31]
        if ahead and ahead[0]:
            self._miss(ahead[0])
            self._next = _ahead(begin, ahead[0])

    def _keep(self, message: Message) -> None:
        changes = in_order_of_time(self.watched.changes_of(message))
        if not len(changes):
            return
        if len(changes) > _MOST_CHANGES:
            raise Senseless(
                f"{len(changes)} changes at once, {NOTIFICATIONS_PER_PUBLISH} were asked"
            )
        self._tally.notifications += len(changes)
        self._tally.overflows += message.overflows
        self.watched.count(changes)
        number = message.sequence_number
        part = Part(changes, self._id, number, self._behind_gap, message.overflows)
        self._behind_gap = False
        self.buffer.add(part)


def _after(number: int) -> int:
    """Return the next sequence number; they wrap from 2**32 - 1 to 1 (Part 4, 7.8)."""
    return number + 1 if number < 2**32 - 1 else 1


def _ahead(number: int, steps: int) -> int:
    for _ in range(steps):
        number = _after(number)
    return number
