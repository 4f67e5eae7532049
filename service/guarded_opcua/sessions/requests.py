"""A request of an active session, and the form of what answers it."""

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import Any

from asyncua import ua

from guarded_opcua.audit import Actor
from guarded_opcua.sessions.session import Session
from guarded_opcua.turn import Turn


@dataclass(frozen=True)
class Request:
    """One request of an active session."""

    session: Session
    request_id: int
    header: ua.RequestHeader
    turn: Turn

    @property
    def handle(self) -> int:
        """RequestHandle, the client's number of the request."""
        return int(self.header.RequestHandle)

    @property
    def actor(self) -> Actor:
        """The client that sent the request."""
        return Actor(self.session, self.session.host, self.header.AuditEntryId or "")


Handler = Callable[[Request, Any], Awaitable[Any]]
Handlers = Mapping[int, tuple[type, Handler]]  # by the service's number: type of parameters, answer
