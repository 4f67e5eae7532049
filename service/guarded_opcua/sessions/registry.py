"""All sessions of a server: created, admitted, found, closed (Part 4, 5.7)."""

import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from asyncua import ua
from asyncua.common.utils import ServiceError

from guarded_opcua.clock import Clock
from guarded_opcua.ledger import Ledger
from guarded_opcua.security.accounts import Role
from guarded_opcua.security.identity import Principal
from guarded_opcua.sessions.session import Line, Session
from guarded_opcua.settings import Limits
from guarded_opcua.subscriptions.pace import Pace
from guarded_opcua.subscriptions.subscription import Subscription

_Codes = ua.StatusCodes


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
