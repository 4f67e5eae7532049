"""asyncua's internal server, used only for the address space and the internal session."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from asyncua.server.address_space import AddressSpace
from asyncua.server.internal_server import InternalServer
from asyncua.server.subscription_service import SubscriptionService
from asyncua.server.user_managers import UserManager
from typing_extensions import override

from guarded_opcua.address_space.standard_nodes import load_standard_address_space
from guarded_opcua.logs import bounded_logger

_log = bounded_logger(__name__)


class AsyncuaServer(InternalServer):
    """Holds the address space; peers never reach its sessions, users or services."""

    def __init__(self, cache: Path | None) -> None:
        self._cache = cache
        super().__init__(user_manager=_Nobody())
        self.disabled_clock = True  # self_description.py updates CurrentTime instead
        self.allow_remote_admin = False

    def hand_events_to(self, to_peers: Callable[[Any], None]) -> None:
        """Forward events that are created with asyncua to the subscriptions of peers."""
        service = _EventForwarder(self.aspace, self, to_peers)
        self.subscription_service = service
        self.isession.subscription_service = service

    @override
    async def load_standard_address_space(self, shelf_file: Path | None = None) -> None:
        await load_standard_address_space(self.aspace, self.node_mgt_service, self._cache)


class _EventForwarder(SubscriptionService):
    def __init__(
        self, aspace: AddressSpace, server: AsyncuaServer, to_peers: Callable[[Any], None]
    ) -> None:
        super().__init__(aspace, server)
        self._to_peers = to_peers

    @override
    async def trigger_event(self, event: Any, subscription_id: int | None = None) -> None:
        await super().trigger_event(event, subscription_id)
        if subscription_id is None:
            self._to_peers(event)


class _Nobody(UserManager):
    @override
    def get_user(self, *_: object, **__: object) -> None:
        return None
