"""Sessions: created, activated, moved to another channel, closed (Part 4, 5.7)."""

import math
import secrets
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

from asyncua import ua
from asyncua.common.utils import ServiceError

from guarded_opcua.address_space.browse import Continuations
from guarded_opcua.clock import Clock
from guarded_opcua.history.reading import Rests
from guarded_opcua.ledger import Holding, Ledger
from guarded_opcua.logs import bounded_logger
from guarded_opcua.security.identity import ANONYMOUS, Principal
from guarded_opcua.security.users import Role
from guarded_opcua.settings import Limits
from guarded_opcua.subscriptions.pace import Pace
from guarded_opcua.subscriptions.publish_queue import PublishQueue, PublishRequest
from guarded_opcua.subscriptions.subscription import Message, Subscription

_log = bounded_logger(__name__)
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
        if any(subscription.available for subscription in self.subscriptions.values()):
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


@dataclass
class SessionTotals:
    """Totals of all sessions, for the server's diagnostics."""

    created: int = 0
    timed_out: int = 0
    refused: int = 0
    refused_for_security: int = 0


class Sessions:
    """All sessions, by authentication token."""

    def __init__(
        self,
        limits: Limits,
        clock: Clock,
        ledger: Ledger,
        pace: Pace,
        end_subscription: Callable[[Subscription], None],
    ) -> None:
        self.totals = SessionTotals()
        self._limits = limits
        self._clock = clock
        self._ledger = ledger
        self._pace = pace
        self._end_subscription = end_subscription
        self._by_token: dict[bytes, Session] = {}

    def __iter__(self) -> Iterator[Session]:
        return iter(list(self._by_token.values()))

    def __len__(self) -> int:
        return len(self._by_token)

    def create(self, line: Line, params: ua.CreateSessionParameters) -> Session:
        """Create a session; at the limit, an unused session is closed.

        Sessions that are not activated are closed first, at the address with the most of them.
        """
        limits = self._limits
        of_host = [session for session in self if session.host == line.host]
        if len(of_host) >= limits.sessions_per_host:
            self._give_way(of_host)
        if len(self) >= limits.sessions:
            self._give_way(list(self))
        wish = params.RequestedSessionTimeout
        wish = wish if math.isfinite(wish) and wish > 0 else limits.session_timeout_ms
        timeout = min(max(wish, limits.shortest_session_timeout_ms), limits.session_timeout_ms)
        session = Session(
            line,
            (params.SessionName or "")[:200],
            timeout / 1e3,
            limits,
            self._clock,
            self._ledger,
            self._pace,
        )
        session.max_response_bytes = params.MaxResponseMessageSize
        session.application_uri = (params.ClientDescription.ApplicationUri or "")[:500]
        self._by_token[session.token.Identifier] = session
        self.totals.created += 1
        return session

    def admit(self, session: Session, principal: Principal) -> None:
        """Admit a user to a session; a share of the sessions is reserved for operators and above.

        Raises
        ------
        ServiceError
            BadTooManySessions.
        """
        if principal.role >= Role.OPERATOR:
            return
        others = [
            other
            for other in self
            if other is not session and other.active and not other.hears(Role.OPERATOR)
        ]
        limits = self._limits
        for held, most in (
            ([other for other in others if other.host == session.host], limits.sessions_per_host),
            (others, limits.sessions),
        ):
            if len(held) >= most - int(limits.reserved_share * most):
                self._give_way(held)

    def find(self, token: ua.NodeId) -> Session:
        """Find a session by its token.

        Raises
        ------
        ServiceError
            BadSessionIdInvalid.
        """
        session = self.get(token)
        if session is None:
            raise ServiceError(_Codes.BadSessionIdInvalid)
        return session

    def get(self, token: ua.NodeId) -> Session | None:
        """Return the session of a token, None if there is none."""
        key = token.Identifier
        known = isinstance(key, bytes) and token.NamespaceIndex == 0
        return self._by_token.get(key) if known else None

    def close(
        self,
        session: Session,
        *,
        code: int = _Codes.BadSessionClosed,
        keep_subscriptions: bool = False,
    ) -> None:
        """Close a session; kept subscriptions can be transferred until they expire."""
        self._by_token.pop(session.token.Identifier, None)
        session.close(code)
        if not keep_subscriptions:
            for subscription in list(session.subscriptions.values()):
                self._end_subscription(subscription)

    def drop_timed_out(self) -> list[Session]:
        """Close the sessions whose time-out has passed; return them."""
        now, dropped = self._clock.monotonic(), []
        for session in self:
            patience = session.timeout_s if session.active else self._limits.handshake_seconds
            if now - session.last_seen > patience:
                self.totals.timed_out += 1
                self.close(session, keep_subscriptions=session.is_proven)
                dropped.append(session)
            else:
                session.queue.drop_expired()
        return dropped

    def lose_line(self, line: Line) -> None:
        """Unbind the sessions of a closed connection; close those that are not activated."""
        for session in self:
            if session.line is line:
                session.unbind(line)
                if not session.active:
                    self.close(session)

    def _give_way(self, candidates: list[Session]) -> None:
        unused = [session for session in candidates if not session.active or session.line is None]
        if not unused:
            self.totals.refused += 1
            raise ServiceError(_Codes.BadTooManySessions)
        of_host = Counter(session.host for session in unused if not session.active)
        self.close(min(unused, key=lambda s: (s.active, -of_host[s.host], s.last_seen)))
