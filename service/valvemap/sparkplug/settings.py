"""Connection settings of the broker."""

from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True)
class BrokerSettings:
    """One MQTT broker, and the credentials for it.

    Without ``ca_file``, the system's certificate authorities are trusted. Files are PEM.
    """

    host: str
    port: int
    client_id: str
    tls: bool = False
    ca_file: Path | None = None
    certificate_file: Path | None = None
    key_file: Path | None = None
    user: str | None = None
    password: str | None = field(default=None, repr=False)
    keep_alive_s: int = 30
    timeout_s: float = 10.0

    @property
    def url(self) -> str:
        """URL of the broker."""
        return f"mqtt{'s' if self.tls else ''}://{self.host}:{self.port}"
