"""State shared by all connections of a server."""

import copy
import secrets
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlparse

from asyncua import ua
from cryptography.hazmat.primitives.asymmetric import rsa

from guarded_opcua.audit import Audit
from guarded_opcua.clock import Clock
from guarded_opcua.security.login_queue import LoginQueue
from guarded_opcua.security.peer_certificates import PeerTrust
from guarded_opcua.security.users import UserStore
from guarded_opcua.sessions.registry import Sessions
from guarded_opcua.sessions.services import Services
from guarded_opcua.settings import Limits
from guarded_opcua.transport.fair_turns import FairTurns

_ARRIVALS_BYTES = 64 * 1024
_SECURITY_CODES = {
    getattr(ua.StatusCodes, name)
    for name in vars(ua.StatusCodes)
    if name.startswith(("BadCertificate", "BadSecurity", "BadIdentityToken", "BadUser"))
}


@dataclass
class Traffic:
    """Counters of requests and refusals since the start."""

    requests: int = 0
    refused_requests: int = 0
    refused_for_security: int = 0
    refused_connections: int = 0

    def count_refusal(self, code: int) -> None:
        """Count a request that was answered with a fault."""
        self.refused_requests += 1
        self.refused_for_security += code in _SECURITY_CODES


@dataclass(frozen=True)
class Own:
    """The server's own certificate (DER) and key, and the security policies that it offers."""

    certificate: bytes
    key: rsa.RSAPrivateKey
    policies: list[Any]


class ChannelNumbers:
    """Allocates consecutive channel numbers from a random start."""

    def __init__(self) -> None:
        self._newest = secrets.randbits(16)

    def get_new_channel_id(self) -> int:
        """Return the number of a new channel (asyncua's name)."""
        self._newest = self._newest % 0xFFFF_FFFE + 1
        return self._newest


@dataclass(frozen=True)
class Shared:
    """The parts of the server that its connections use.

    Attributes
    ----------
    arrivals
        Receive buffer of all connections; emptied after each read.
    logins
        Verifies passwords, one at a time.
    gateways
        Application URIs of clients that log users in on their behalf.
    """

    limits: Limits
    clock: Clock
    users: UserStore
    trust: PeerTrust
    sessions: Sessions
    services: Services
    audit: Audit
    own: Own
    turns: FairTurns
    logins: LoginQueue
    anonymous_allowed: bool
    gateways: frozenset[str] = frozenset()
    traffic: Traffic = field(default_factory=Traffic)
    channel_numbers: ChannelNumbers = field(default_factory=ChannelNumbers)
    offered: list[ua.EndpointDescription] = field(default_factory=list)
    arrivals: memoryview = field(default_factory=lambda: memoryview(bytearray(_ARRIVALS_BYTES)))

    def endpoints(self, reached_as: str | None) -> list[ua.EndpointDescription]:
        """Return the endpoints, with the host and port that the peer used."""
        if reached_as is None:
            return self.offered
        found = []
        for endpoint in self.offered:
            own = copy.copy(endpoint)
            own.EndpointUrl = _with_netloc(own.EndpointUrl, reached_as)
            own.Server = copy.copy(own.Server)
            own.Server.DiscoveryUrls = [own.EndpointUrl]
            found.append(own)
        return found


def _with_netloc(url: str, netloc: str) -> str:
    return urlparse(url)._replace(netloc=netloc).geturl()
