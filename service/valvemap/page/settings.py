"""Address of the page, its users, and limits for its visitors."""

import ipaddress
from dataclasses import dataclass
from pathlib import Path

from valvemap.errors import ConfigurationError

LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "[::1]"})


@dataclass(frozen=True)
class PageSettings:
    """Address, access and limits of the page.

    Attributes
    ----------
    host, port
        Address to listen on; port 0 selects a free one.
    host_names
        Host names accepted beside loopback's. Any other is refused, which prevents DNS rebinding.
    certificate, key
        PEM files for https. Off loopback, log-in requires them.
    viewers, viewers_of_address
        Open pages, in total and of one address (an IPv6 network of 64 bits is one address).
    connections, connections_of_address, connections_per_s
        Connections, viewers included, in total and of one address; new connections of one address
        a second. Each takes one descriptor.
    handshakes, handshakes_of_address, handshakes_per_s
        TLS handshakes in progress, in total and of one address; new handshakes of one address a
        second. Each takes 300 kB and some 2 ms of CPU time.
    handshake_s, request_s, answer_s
        Timeouts: of the TLS handshake; from connecting or the last answer to the next request; of
        reading the answer.
    requests_per_s, request_burst
        Of one address.
    log_ins, log_ins_of_user
        Log-ins, in total and of one user; beyond that, the least recently used ends.
    log_ins_per_s, log_in_burst
        Tries of one address.
    wrong_passwords, wrong_pause_s
        Wrong passwords of one user from one address, and the lockout after them: fewer than at
        the service (5), and longer than the service's memory (300 s).
    log_in_idle_s
        Idle timeout of a log-in.
    body_bytes
        Largest request.
    takes_addresses
        Whether any IP address is accepted as host name, too: rebinding needs a name.
    """

    host: str = "127.0.0.1"
    port: int = 8080
    host_names: tuple[str, ...] = ()
    certificate: Path | None = None
    key: Path | None = None
    viewers: int = 50
    viewers_of_address: int = 25
    connections: int = 120
    connections_of_address: int = 60
    connections_per_s: int = 500
    handshakes: int = 20
    handshakes_of_address: int = 10
    handshakes_per_s: int = 50
    handshake_s: float = 5.0
    request_s: float = 15.0
    answer_s: float = 60.0
    requests_per_s: float = 50.0
    request_burst: float = 300.0
    log_ins: int = 8
    log_ins_of_user: int = 4
    log_ins_per_s: float = 0.2
    log_in_burst: float = 10.0
    wrong_passwords: int = 3
    wrong_pause_s: float = 305.0
    log_in_idle_s: float = 900.0
    body_bytes: int = 4_096
    takes_addresses: bool = False

    def __post_init__(self) -> None:
        """Check that the settings are consistent.

        Raises
        ------
        ConfigurationError
        """
        if (self.certificate is None) != (self.key is None):
            raise ConfigurationError("--certificate and --key: one is of no use without the other")
        for file in (self.certificate, self.key):
            if file is not None and not file.is_file():
                raise ConfigurationError(f"{file}: no such file")

    @property
    def is_encrypted(self) -> bool:
        """Whether the page is served by https."""
        return self.certificate is not None

    @property
    def may_log_in(self) -> bool:
        """Whether passwords are protected in transit: on loopback, or encrypted."""
        return self.is_encrypted or is_loopback(self.host)

    def accepts(self, name: str) -> bool:
        """Whether requests may name this host.

        >>> PageSettings().accepts("localhost"), PageSettings().accepts("10.0.0.5")
        (True, False)
        """
        if name in LOOPBACK_NAMES or name in {own.lower() for own in self.host_names}:
            return True
        return self.takes_addresses and _is_address(name.strip("[]"))


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def is_loopback(host: str) -> bool:
    """Whether an address is a loopback address.

    >>> is_loopback("127.0.0.1"), is_loopback("0.0.0.0")
    (True, False)
    """
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
