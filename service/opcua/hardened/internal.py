"""asyncua's internal server, for what stays its own: the address space and the server's session."""

from pathlib import Path
from typing import Any

from asyncua.server.address_space import AddressSpace
from asyncua.server.internal_server import InternalServer
from asyncua.server.subscription_service import SubscriptionService
from asyncua.server.user_managers import UserManager
from typing_extensions import override

from service.opcua.hardened.address_space import load_standard_address_space
from service.opcua.hardened.event_filter import event_of_asyncua
from service.opcua.hardened.logs import bounded_logger
from service.opcua.hardened.subscription_service import Subscriptions

_log = bounded_logger(__name__)


class InsideServer(InternalServer):
    """Holds the address space; peers never reach its sessions, users or services."""

    def __init__(self, cache: Path | None) -> None:
        self._cache = cache
        super().__init__(user_manager=_Nobody())
        self.disabled_clock = True  # the server writes its times itself, see diagnostics.py
        self.allow_remote_admin = False

    def hand_events_to(self, subscriptions: Subscriptions) -> None:
        """Let events of the server reach the subscriptions of peers."""
        service = _EventForwarder(self.aspace, self, subscriptions)
        self.subscription_service = service
        self.isession.subscription_service = service

    @override
    async def load_standard_address_space(self, shelf_file: Path | None = None) -> None:
        await load_standard_address_space(self.aspace, self.node_mgt_service, self._cache)


class _EventForwarder(SubscriptionService):
    def __init__(
        self, aspace: AddressSpace, server: InsideServer, subscriptions: Subscriptions
    ) -> None:
        super().__init__(aspace, server)
        self._of_peers = subscriptions

    @override
    async def trigger_event(self, event: Any, subscription_id: int | None = None) -> None:
        await super().trigger_event(event, subscription_id)
        if subscription_id is None:
            self._of_peers.trigger_event(event_of_asyncua(event))


class _Nobody(UserManager):
    @override
    def get_user(self, *_: object, **__: object) -> None:
        return None
