"""A session: created, activated, moved to another channel, closed (Part 4, 5.7)."""

import secrets
from collections import OrderedDict
from typing import Protocol

from asyncua import ua
from asyncua.common.utils import ServiceError

from guarded_opcua.address_space.browse import Continuations
from guarded_opcua.clock import Clock
from guarded_opcua.history.reading import Rests
from guarded_opcua.ledger import Holding, Ledger
from guarded_opcua.security.accounts import Role
from guarded_opcua.security.identity import ANONYMOUS, Principal
from guarded_opcua.settings import Limits
from guarded_opcua.subscriptions.pace import Pace
from guarded_opcua.subscriptions.publish_queue import PublishQueue, PublishRequest
from guarded_opcua.subscriptions.subscription import Message, Subscription

_Codes = ua.StatusCodes
_TIME_TO_ASK_AGAIN_S = 0.5


class Line(Protocol):
    """The connection that a session is bound to."""

    @property
    def host(self) -> str:
        """Address of the peer."""

    @property
    def peer_certificate(self) -> bytes | None:
        """Certificate of the secure channel (DER), None without security."""

    @property
    def writable(self) -> bool:
        """Whether the send buffer accepts more data."""

    def answer_publish(self, request: PublishRequest, number: int, message: Message) -> None:
        """Send a publish response."""

    def refuse(self, request_id: int, handle: int, code: int) -> None:
        """Send a fault."""

    def charge(self, cost: float) -> None:
        """Charge processor time to the connection, s."""


class Session:
    """A session: its user, its subscriptions, its publish requests."""

    def __init__(
        self,
        line: Line,
        name: str,
        timeout_s: float,
        limits: Limits,
        clock: Clock,
        ledger: Ledger,
        pace: Pace,
    ) -> None:
        self.id = ua.NodeId(secrets.token_bytes(16), 1, ua.NodeIdType.ByteString)
        self.token = ua.NodeId(secrets.token_bytes(32), 0, ua.NodeIdType.ByteString)
        self.name = name
        self.timeout_s = timeout_s
        self.line: Line | None = line
        self.host = line.host
        self.peer_certificate = line.peer_certificate
        self.application_uri = ""
        self.principal: Principal | None = None
        self.nonce = secrets.token_bytes(32)
        self.max_response_bytes = 0
        self.subscriptions: dict[int, Subscription] = {}
        self.continuations: Continuations = OrderedDict()
        self.rests: Rests = OrderedDict()
        self.holding = Holding(ledger)
        self.created = clock.now()
        self._clock = clock
        self.last_seen = clock.monotonic()
        self.closed = False
        self._quiet_until = 0.0
        self.queue = PublishQueue(
            limits.publish_requests,
            self._answer,
            self._refuse,
            self._is_ready,
            clock,
            pace,
        )

    @property
    def active(self) -> bool:
        """Whether a user is logged in."""
        return self.principal is not None and not self.closed

    @property
    def user(self) -> str:
        """Return the name of the logged-in user; empty before the log-in."""
        return "" if self.principal is None else self.principal.name

    @property
    def role(self) -> Role:
        """Return the role of the logged-in user."""
        if self.principal is None:
            raise ServiceError(_Codes.BadSessionNotActivated)
        return self.principal.role

    def hears(self, audience: Role) -> bool:
        """Return whether the user may receive events for that role and above."""
        return self.principal is not None and self.principal.role >= audience

    def charge(self, cost: float) -> None:
        """Charge processor time to the session's connection, s."""
        if self.line is not None:
            self.line.charge(cost)

    def touch(self) -> None:
        """Restart the session time-out."""
        self.last_seen = self._clock.monotonic()

    def new_nonce(self) -> bytes:
        """Return a new nonce, which the next ActivateSession must sign."""
        self.nonce = secrets.token_bytes(32)
        return self.nonce

    def bind(self, line: Line) -> None:
        """Move to another connection; drop the publish requests of the old one.

        Messages sent over the old connection and not acknowledged may be lost. New messages are
        held back until the client has called Republish for those, or until a time-out, so that the
        client receives all messages in order.
        """
        self.queue.lose_connection()
        self.line = line
        self.host = line.host
        if any(subscription.sent.available for subscription in self.subscriptions.values()):
            self._quiet_until = self._clock.monotonic() + _TIME_TO_ASK_AGAIN_S
            self._clock.call_at(self._quiet_until, self.nothing_to_ask_again)

    def nothing_to_ask_again(self) -> None:
        """Resume publishing: the client has no more messages to republish."""
        self._quiet_until = 0.0
        self.queue.serve()

    def unbind(self, line: Line) -> None:
        """Detach from a lost connection; the session continues until its time-out."""
        if self.line is line:
            self.queue.lose_connection()
            self.line = None
            self.touch()

    def is_same_client(self, other: object) -> bool:
        """Whether another session acts for the same user of the same application.

        Anonymous users of a channel without security cannot prove their identity.
        """
        if not isinstance(other, Session) or self.principal is None:
            return False
        if other is self:
            return True
        return (
            self.is_proven
            and self.principal == other.principal
            and self.peer_certificate == other.peer_certificate
        )

    @property
    def is_proven(self) -> bool:
        """Whether the client is authenticated, by password or certificate."""
        return self.principal is not None and (
            self.peer_certificate is not None or self.principal.name != ANONYMOUS
        )

    def add_publish_request(self, request: PublishRequest) -> None:
        """Queue a publish request, and restart the lifetimes of the subscriptions."""
        for subscription in self.subscriptions.values():
            subscription.heard_of()
        self.queue.add(request)

    def publish(self, subscription: Subscription) -> None:
        """Send a subscription's messages while publish requests are queued."""
        self.queue.publish(subscription)

    def has_publish_requests(self) -> bool:
        """Return whether a publish request is queued."""
        return len(self.queue) > 0

    def lose(self, subscription: Subscription, code: int | None = None) -> None:
        """Detach a subscription that was deleted or, if a code is given, transferred."""
        self.subscriptions.pop(subscription.number, None)
        self.queue.forget(subscription)
        if code is not None:
            self.queue.notify(subscription.number, code)
        if not self.subscriptions:
            self.queue.refuse_all(_Codes.BadNoSubscription)

    def close(self, code: int) -> None:
        """Close the session; answer its publish requests with the code."""
        self.closed = True
        self.queue.refuse_all(code)
        self.continuations.clear()
        self.rests.clear()

    def _answer(self, request: PublishRequest, number: int, message: Message) -> None:
        if self.line is not None:
            self.line.answer_publish(request, number, message)

    def _refuse(self, request: PublishRequest, code: int) -> None:
        if self.line is not None:
            self.line.refuse(request.request_id, request.handle, code)

    def _is_ready(self) -> bool:
        return (
            self.line is not None
            and self.line.writable
            and self._clock.monotonic() >= self._quiet_until
        )
