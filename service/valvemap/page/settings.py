"""Where the page is served, to whom, and what visitors may cost."""

import ipaddress
from dataclasses import dataclass
from pathlib import Path

from valvemap.errors import ConfigurationError

LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "[::1]"})


@dataclass(frozen=True)
class PageSettings:
    """Where and for whom.

    Attributes
    ----------
    host, port
        Address to listen on; port 0 takes a free one.
    host_names
        Names under which browsers may come, beside loopback's; any other is refused, so that no
        foreign name can be bound to this address.
    certificate, key
        PEM files for https. Off loopback nobody can log in without them.
    viewers, viewers_of_address
        Open pages at once, and those of one address (an IPv6 network of 64 bits counts as one).
    connections, connections_of_address, connections_per_s
        Connections at once, and those of one address, viewers included; how many of one address
        are considered in a second. Each takes one descriptor.
    handshakes, handshakes_of_address, handshakes_per_s
        TLS handshakes under way, and those of one address; those of one address in a second. Each
        takes 300 kB and some 2 ms of the processor.
    handshake_s, request_s, answer_s
        For TLS; from connecting, or from the last answer, to a request; for its answer to be read.
    requests_per_s, request_burst
        Of one address.
    log_ins, log_ins_of_user
        Log-ins at once, and those of one user; the one that was not used for longest ends.
    log_ins_per_s, log_in_burst
        Tries of one address.
    wrong_passwords, wrong_pause_s
        Wrong passwords of one user from one address, and the wait after them: fewer than the
        service locks the user out for (5), and longer than it remembers (300 s).
    log_in_idle_s
        A log-in that is not used for so long ends.
    body_bytes
        Largest request.
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

    def __post_init__(self) -> None:
        """Check what goes together.

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
        """Whether a password can travel safely: on this machine, or encrypted."""
        return self.is_encrypted or is_loopback(self.host)

    @property
    def names(self) -> frozenset[str]:
        """Names under which browsers may come."""
        return LOOPBACK_NAMES | {name.lower() for name in self.host_names}


def is_loopback(host: str) -> bool:
    """Whether an address is this machine's own.

    >>> is_loopback("127.0.0.1"), is_loopback("0.0.0.0")
    (True, False)
    """
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
