"""The server's inside: sessions of our kind, users of our kind, no discovery service."""

import datetime as dt
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession
from asyncua.server.user_managers import UserManager
from typing_extensions import override

from service.opcua.hardened.address_space import load_standard_address_space
from service.opcua.hardened.nodes import Method, Variable
from service.opcua.hardened.session import GuardedSession, Principal
from service.opcua.hardened.settings import ServerSettings
from service.opcua.hardened.users import Role

_log = logging.getLogger(__name__)
TakeWrite = Callable[[Variable, Any, dt.datetime | None], None]


class GuardedInternalServer(InternalServer):
    """asyncua's internal server with our sessions, users and limits."""

    def __init__(self, settings: ServerSettings, take_write: TakeWrite) -> None:
        self.settings = settings
        self.limits = settings.limits
        self.variables: dict[ua.NodeId, Variable] = {}
        self.methods: dict[ua.NodeId, Method] = {}
        self.take_write = take_write
        super().__init__(user_manager=_Users(settings))
        limits = settings.limits
        self.max_connections = limits.connections
        self.max_subscriptions = limits.subscriptions
        self.max_monitored_item_queue_size = limits.queue_size
        self.max_pending_activation_seconds = limits.handshake_seconds
        self.max_unacked_messages_per_subscription = limits.unacknowledged_messages
        self.max_keep_alive_count = limits.keep_alive_count
        self.max_lifetime_count = limits.lifetime_count
        self.max_session_timeout_ms = limits.session_timeout_ms
        self.allow_remote_admin = False

    @override
    async def load_standard_address_space(self, shelf_file: Path | None = None) -> None:
        """Read the standard nodes from our cache."""
        await load_standard_address_space(self.aspace, self.node_mgt_service, self.settings.cache)

    @override
    def create_session(
        self,
        name: str,
        user: User = User(role=UserRole.Anonymous),  # noqa: B008 - asyncua's signature
        external: bool = False,
    ) -> InternalSession:
        """Make a session; a peer's starts without any right."""
        return GuardedSession(
            self, self.aspace, self.subscription_service, name, user=user, external=external
        )

    @override
    def lookup_external_session(self, auth_token: ua.NodeId) -> InternalSession | None:
        """Never hand a session over to another connection on its token alone."""
        return None

    @override
    def register_server(self, server: object, conf: object = None) -> None:
        """Refuse: this is no discovery server."""
        raise ServiceError(ua.StatusCodes.BadServiceUnsupported)


class _Users(UserManager):
    """Answers asyncua's question who logs in."""

    def __init__(self, settings: ServerSettings) -> None:
        self._settings = settings

    @override
    def get_user(
        self,
        iserver: InternalServer,
        username: str | None = None,
        password: str | None = None,
        certificate: bytes | None = None,
    ) -> User | None:
        """Return the user, or None to refuse."""
        if username is not None:
            role = self._settings.users.authenticate(username, password or "")
            return None if role is None else Principal(name=username, level=role)
        if self._settings.none_on_loopback or self._settings.anonymous_observer:
            return Principal(level=Role.OBSERVER)
        return None
