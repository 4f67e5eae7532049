"""The hardened server: its endpoint, sessions and services around a local server."""

import asyncio
from dataclasses import dataclass
from typing import Self
from urllib.parse import urlparse

from cryptography.hazmat.primitives import serialization

from guarded_opcua.address_space.attributes import Attributes
from guarded_opcua.address_space.browse import View
from guarded_opcua.address_space.metadata import describe_namespace
from guarded_opcua.address_space.self_description import SelfDescription
from guarded_opcua.audit import Audit
from guarded_opcua.clock import Clock
from guarded_opcua.errors import ServerError
from guarded_opcua.history.aggregate_kinds import Aggregate
from guarded_opcua.history.events import MOST_EVENTS
from guarded_opcua.lifecycle import Startable
from guarded_opcua.local_server import LocalServer
from guarded_opcua.logs import bounded_logger
from guarded_opcua.security.certificates import expiry_warning
from guarded_opcua.security.login_queue import LoginQueue
from guarded_opcua.security.peer_certificates import PeerTrust
from guarded_opcua.server_certificate import server_certificate
from guarded_opcua.sessions.registry import Sessions
from guarded_opcua.sessions.services import Services
from guarded_opcua.settings import ServerSettings
from guarded_opcua.subscriptions.pace import Pace
from guarded_opcua.transport.endpoints import (
    check_endpoint,
    endpoint_url,
    offered_endpoints,
    offered_policies,
)
from guarded_opcua.transport.fair_turns import FairTurns
from guarded_opcua.transport.listener import Listener
from guarded_opcua.transport.shared import Own, Shared, Traffic

_log = bounded_logger(__name__)


@dataclass(frozen=True)
class ServerCounters:
    """Current sizes of a server, and its totals since the start."""

    sessions: int
    subscriptions: int
    monitored_items: int
    queued_notifications: int
    lost_notifications: int
    requests: int
    refused_requests: int
    refused_connections: int


class HardenedServer(LocalServer, Startable):
    """An OPC UA server with limits, PKI and users.

    Create it with :meth:`create`, add nodes, then use ``async with`` or call :meth:`start` and
    :meth:`stop`.

    Attributes
    ----------
    announcements
        What the server says of itself, such as its ServiceLevel.
    """

    def __init__(self, settings: ServerSettings, clock: Clock | None = None) -> None:
        super().__init__(settings, clock)
        self._port: int | None = None
        limits, aspace = settings.limits, self.address_space
        self._sessions = Sessions(
            limits,
            self._clock,
            self._subscriptions.ledger,
            Pace(self._clock),
            self._subscriptions.end,
        )
        self._view = View(aspace, limits)
        self._attributes = Attributes(
            aspace,
            self._variables,
            self._methods,
            self._take_write,
            self.utc,
        )
        self._audit = Audit(
            settings.application_uri,
            self._subscriptions,
            self._clock,
            limits.audit_events_per_second,
        )
        self._services = Services(
            limits,
            self._clock,
            self._attributes,
            self._view,
            self._subscriptions,
            self._histories,
            self.conditions,
            self._audit,
        )
        self.announcements = SelfDescription(
            aspace, self._write_data_value, self._clock, settings, self._summary
        )
        self._listener: Listener | None = None
        self._traffic = Traffic()

    @classmethod
    async def create(cls, settings: ServerSettings, clock: Clock | None = None) -> Self:
        """Create a server with its standard nodes; it does not listen yet.

        Raises
        ------
        ConfigurationError
            if the settings are inconsistent.
        """
        check_endpoint(settings)
        server = cls(settings, clock)
        await server.ua.init()
        await server.ua.set_application_uri(settings.application_uri)
        server.namespace_index = await server.namespace(settings.namespace_uri)
        describe_namespace(
            server.address_space,
            server.namespace_index,
            settings.namespace_uri,
            settings.namespace_version,
            settings.namespace_published,
        )
        return server

    @property
    def url(self) -> str:
        """Endpoint URL of the server; with port 0, the port is known after the start."""
        return endpoint_url(self.settings, self._port)

    @property
    def counters(self) -> ServerCounters:
        """The current counters."""
        return ServerCounters(
            sessions=len(self._sessions),
            subscriptions=len(self._subscriptions.by_number),
            monitored_items=self._subscriptions.items.count,
            queued_notifications=self._subscriptions.ledger.queued,
            lost_notifications=self._subscriptions.ledger.lost,
            requests=self._traffic.requests,
            refused_requests=self._traffic.refused_requests,
            refused_connections=self._traffic.refused_connections,
        )

    async def start(self) -> None:
        """Start listening.

        Raises
        ------
        ServerError
            if the address is in use or not local; the message names the endpoint.
        CertificateError
            if the certificate or key cannot be loaded or created.
        """
        settings = self.settings
        certificate, key = await asyncio.to_thread(server_certificate, settings)
        if warning := expiry_warning(certificate):
            _log.warning("%s", warning)
        der = certificate.public_bytes(serialization.Encoding.DER)
        shared = Shared(
            limits=settings.limits,
            clock=self._clock,
            users=settings.users,
            trust=PeerTrust(settings.pki, self._clock, require_crl=settings.require_crl),
            sessions=self._sessions,
            services=self._services,
            audit=self._audit,
            own=Own(der, key, offered_policies(settings, certificate, key)),
            turns=FairTurns(self._clock),
            logins=LoginQueue(settings.users, self._clock),
            anonymous_allowed=settings.none_on_loopback or settings.anonymous_observer,
            gateways=settings.gateways,
            traffic=self._traffic,
        )
        listener = Listener(shared)
        self._view.forget_types()
        parsed = urlparse(settings.url)
        try:
            self._port = await listener.start(parsed.hostname or "", parsed.port or 0)
        except OSError as error:
            reason = error.strerror or str(error)
            raise ServerError(f"{settings.url}: cannot listen there: {reason}") from error
        self._listener = listener
        shared.offered.extend(offered_endpoints(settings, self.url, der))
        self.announcements.announce(
            tuple(Aggregate) if self._has_history else None,
            conditions=self.conditions.keeper is not None,
            past_events=MOST_EVENTS if self._has_past_events else 0,
        )
        self.announcements.start()
        if settings.none_on_loopback:
            _log.warning("%s: also open without security, on loopback (demo only)", self.url)

    async def stop(self) -> None:
        """Stop listening and close every session; safe to call twice."""
        listener, self._listener = self._listener, None
        if listener is not None:
            self.announcements.stop()
            await listener.stop()
            await self._inside.stop()

    def _summary(self) -> dict[str, int]:
        totals, traffic = self._sessions.totals, self._traffic
        intervals = {s.timing.interval_s for s in self._subscriptions.by_number.values()}
        return {
            "CurrentSessionCount": len(self._sessions),
            "CumulatedSessionCount": totals.created,
            "SecurityRejectedSessionCount": totals.refused_for_security,
            "RejectedSessionCount": totals.refused + totals.refused_for_security,
            "SessionTimeoutCount": totals.timed_out,
            "PublishingIntervalCount": len(intervals),
            "CurrentSubscriptionCount": len(self._subscriptions.by_number),
            "CumulatedSubscriptionCount": self._subscriptions.created,
            "SecurityRejectedRequestsCount": traffic.refused_for_security,
            "RejectedRequestsCount": traffic.refused_requests,
        }
