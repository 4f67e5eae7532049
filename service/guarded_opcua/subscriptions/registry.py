"""The subscriptions of all sessions: create, modify, transfer and delete, within the limits."""

import math
from collections.abc import Iterable
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.server.address_space import AddressSpace

from guarded_opcua.chores import Chores
from guarded_opcua.clock import Clock
from guarded_opcua.ledger import Ledger
from guarded_opcua.logs import bounded_logger
from guarded_opcua.settings import Limits
from guarded_opcua.subscriptions.events import EventDelivery
from guarded_opcua.subscriptions.monitored_items import Breathe, MonitoredItems, owned, reserved
from guarded_opcua.subscriptions.sent_messages import RepublishStore
from guarded_opcua.subscriptions.subscription import (
    Owner,
    Subscription,
    Timing,
)

_log = bounded_logger(__name__)
_Codes = ua.StatusCodes


class Subscriptions:
    """All subscriptions; each service checks that the session owns the named subscription."""

    def __init__(self, aspace: AddressSpace, limits: Limits, clock: Clock) -> None:
        self.ledger = Ledger(limits.queued_notifications)
        self.chores = Chores(clock)
        self.by_number: dict[int, Subscription] = {}
        self.created = 0
        self._limits = limits
        self._store = RepublishStore(limits.unacknowledged_messages, limits.unacknowledged_bytes)
        self._clock = clock
        self.events = EventDelivery(self.chores, clock)
        self.items = MonitoredItems(aspace, limits, self.events)

    def create(
        self, session: Owner, params: ua.CreateSubscriptionParameters
    ) -> ua.CreateSubscriptionResult:
        """Create a subscription."""
        limits = self._limits
        room = limits.subscriptions - reserved(limits, session, limits.subscriptions)
        if (
            len(session.subscriptions) >= limits.subscriptions_per_session
            or len(self.by_number) >= room
        ):
            raise ServiceError(_Codes.BadTooManySubscriptions)
        timing = self._timing(params, params.Priority)
        self.created += 1
        subscription = Subscription(
            self.created,
            session,
            timing,
            self._store,
            self._clock,
            self._expire,
            publishing=bool(params.PublishingEnabled),
        )
        self.by_number[subscription.number] = subscription
        session.subscriptions[subscription.number] = subscription
        self._share()
        return ua.CreateSubscriptionResult(
            SubscriptionId=subscription.number,
            RevisedPublishingInterval=timing.interval_s * 1e3,
            RevisedLifetimeCount=timing.lifetime_count,
            RevisedMaxKeepAliveCount=timing.keep_alive_count,
        )

    def modify(
        self, session: Owner, params: ua.ModifySubscriptionParameters
    ) -> ua.ModifySubscriptionResult:
        """Modify the parameters of a subscription."""
        subscription = owned(session, params.SubscriptionId)
        timing = self._timing(params, params.Priority)
        subscription.retime(timing)
        return ua.ModifySubscriptionResult(
            RevisedPublishingInterval=timing.interval_s * 1e3,
            RevisedLifetimeCount=timing.lifetime_count,
            RevisedMaxKeepAliveCount=timing.keep_alive_count,
        )

    def set_publishing(self, session: Owner, number: int, *, enabled: bool) -> int:
        """Enable or disable the publishing of a subscription; return a status code."""
        subscription = session.subscriptions.get(number)
        if subscription is None:
            return int(_Codes.BadSubscriptionIdInvalid)
        subscription.publishing = enabled
        subscription.heard_of()
        return int(_Codes.Good)

    def delete(self, session: Owner, number: int) -> int:
        """Delete a subscription; return a status code."""
        subscription = session.subscriptions.get(number)
        if subscription is None:
            return int(_Codes.BadSubscriptionIdInvalid)
        self.end(subscription)
        return int(_Codes.Good)

    def end(self, subscription: Subscription) -> None:
        """Delete a subscription now, and its items in the background."""
        owner = subscription.owner
        subscription.stop()
        self.by_number.pop(subscription.number, None)
        owner.lose(subscription)
        self._share()
        self.chores.add(self.items.forget_all(subscription), owner.charge)

    async def transfer(
        self, session: Owner, number: int, breathe: Breathe, *, send_values: bool
    ) -> ua.TransferResult:
        """Transfer a subscription of the same user to this session."""
        moves = number not in session.subscriptions
        result = self._transfer(session, number)
        if moves and send_values and number in session.subscriptions:
            await self.items.resend(session, number, breathe)
        return result

    def republish(self, session: Owner, params: ua.RepublishParameters) -> bytes:
        """Return an unacknowledged message."""
        subscription = owned(session, params.SubscriptionId)
        content = subscription.republish(params.RetransmitSequenceNumber)
        if content is None:
            raise ServiceError(_Codes.BadMessageNotAvailable)
        return content

    def acknowledge(
        self, session: Owner, acks: Iterable[ua.SubscriptionAcknowledgement]
    ) -> tuple[int, ...]:
        """Acknowledge messages; return a status code for each."""
        codes = []
        for ack in acks:
            subscription = session.subscriptions.get(ack.SubscriptionId)
            if subscription is None:
                codes.append(_Codes.BadSubscriptionIdInvalid)
            else:
                codes.append(subscription.sent.acknowledge(ack.SequenceNumber))
        return tuple(codes)

    def _share(self) -> None:
        owners = {id(subscription.owner) for subscription in self.by_number.values()}
        self.ledger.sessions = max(1, len(owners))

    def _timing(self, params: Any, priority: int) -> Timing:  # noqa: ANN401 - create or modify
        limits = self._limits
        interval = params.RequestedPublishingInterval
        if not interval >= limits.publishing_interval_ms:  # NaN too
            interval = limits.publishing_interval_ms
        interval = min(interval, limits.longest_publishing_interval_ms)
        asked = params.RequestedMaxKeepAliveCount or limits.keep_alive_count
        keep_alive = min(asked, limits.keep_alive_count)
        longest = max(3, math.floor(limits.longest_lifetime_s * 1e3 / interval))
        keep_alive = max(1, min(keep_alive, longest // 3))
        lifetime = min(params.RequestedLifetimeCount, limits.lifetime_count, longest)
        most = limits.notifications_per_publish
        wanted = params.MaxNotificationsPerPublish or most
        return Timing(
            interval_s=interval / 1e3,
            keep_alive_count=keep_alive,
            lifetime_count=max(lifetime, 3 * keep_alive),
            notifications_per_publish=min(wanted, most),
            priority=priority,
        )

    def _transfer(self, session: Owner, number: int) -> ua.TransferResult:
        subscription = self.by_number.get(number)
        if subscription is None or not session.is_same_client(subscription.owner):
            denied = _Codes.BadSubscriptionIdInvalid
            if subscription is not None:
                denied = _Codes.BadUserAccessDenied
            return ua.TransferResult(StatusCode=ua.StatusCode(denied))
        available = list(subscription.sent.available)
        if subscription.owner is session:
            return ua.TransferResult(StatusCode=ua.StatusCode(), AvailableSequenceNumbers=available)
        if len(session.subscriptions) >= self._limits.subscriptions_per_session:
            code = ua.StatusCode(_Codes.BadTooManySubscriptions)
            return ua.TransferResult(StatusCode=code)
        old = subscription.owner
        old.lose(subscription, _Codes.GoodSubscriptionTransferred)
        self.items.move(subscription, old, session)
        subscription.give_to(session)
        session.subscriptions[number] = subscription
        return ua.TransferResult(StatusCode=ua.StatusCode(), AvailableSequenceNumbers=available)

    def _expire(self, subscription: Subscription) -> None:
        _log.info(
            "subscription %d expired: no publish request within its lifetime", subscription.number
        )
        self.end(subscription)
