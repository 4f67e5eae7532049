"""Address, security and subscription settings of one OPC UA server."""

from dataclasses import dataclass, field
from enum import StrEnum
from urllib.parse import urlsplit

from guarded_opcua.security.own_certificate import OwnCertificate
from guarded_opcua.security.pki_folders import Pki
from valvemap.errors import ConfigurationError


class Security(StrEnum):
    """How a connection is protected; all but NONE sign and encrypt."""

    NONE = "None"
    BASIC256_SHA256 = "Basic256Sha256"
    AES256_SHA256_RSA_PSS = "Aes256Sha256RsaPss"


@dataclass(frozen=True)
class SourceSettings:
    """Address, security and subscription settings of one OPC UA server.

    Attributes
    ----------
    url
        E.g. ``opc.tcp://127.0.0.1:4840/valvemap/rig/``.
    security
        Protection of the connection.
    pki, own
        Trust store and our certificate; required unless ``security`` is NONE.
    user, password
        Credentials; anonymous if ``user`` is None. The password is left out of ``repr`` and is
        never sent unencrypted, except to the loopback interface.
    on_behalf_of
        Address of the peer for which this client logs in; the server attributes failed logins to
        it.
    check_host_name
        Whether the server's certificate must name the host of ``url``.
    require_crl
        Whether the CA that issued the server's certificate needs a valid revocation list.
    application_uri
        Our application URI; None: taken from the certificate.
    publishing_interval_ms
        Requested publishing interval.
    sampling_interval_ms
        Requested sampling interval of a node; 0 = on every change.
    queue_size
        Requested queue size of a monitored item, in values.
    keep_alive_s
        Requested keep-alive time. Three missing keep-alives mean that the connection is lost.
    timeout_s
        Timeout of connecting and of every request.
    publish_requests
        Number of publish requests in flight.
    buffer_limit
        Changes buffered until ``receive`` returns them. Overflow policy: *back-pressure*. At the
        limit no further publish request is sent, so the server's queues fill. The values they drop
        are counted in ``counters.overflows``.
    history_s
        How far back missed data are read from the server's history; 0: never.
    warm_start_s
        How far back the server's history is read at the first start; 0: not at all.
    """

    url: str
    security: Security = Security.NONE
    pki: Pki | None = None
    own: OwnCertificate | None = None
    user: str | None = None
    password: str | None = field(default=None, repr=False)
    on_behalf_of: str = ""
    check_host_name: bool = True
    require_crl: bool = True
    application_uri: str | None = None
    publishing_interval_ms: float = 100.0
    sampling_interval_ms: float = 0.0
    queue_size: int = 1_000
    keep_alive_s: float = 1.0
    timeout_s: float = 5.0
    publish_requests: int = 10
    buffer_limit: int = 1_000_000
    history_s: float = 3_600.0
    warm_start_s: float = 0.0

    def __post_init__(self) -> None:
        """Check the fields and their combination.

        Raises
        ------
        ConfigurationError
            if a field is invalid; names the field.
        """
        parts = urlsplit(self.url)
        if parts.scheme != "opc.tcp" or not parts.hostname or _port(self.url) is None:
            raise ConfigurationError(
                f"url '{self.url}': opc.tcp://<host>:<port>[/<path>] is expected"
            )
        if parts.username is not None:
            raise ConfigurationError(
                f"url of {parts.hostname}: credentials belong to user and password"
            )
        if self.security is not Security.NONE and (self.pki is None or self.own is None):
            raise ConfigurationError(
                f"security {self.security}: pki and own certificate are needed"
            )


def _port(url: str) -> int | None:
    try:
        return urlsplit(url).port
    except ValueError:
        return None
