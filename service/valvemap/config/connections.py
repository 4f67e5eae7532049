"""The sections of the source, of the results server and of certificates."""

from pathlib import Path
from typing import Literal

from pydantic import Field, SecretStr

from valvemap.config.names import Name
from valvemap.config.sections import Section

SecurityPolicy = Literal["None", "Basic256Sha256", "Aes256Sha256RsaPss"]


class SourceConfig(Section):
    """The OPC UA server that publishes the signals."""

    url: str = Field(
        "opc.tcp://127.0.0.1:4840/valvemap/rig/",
        pattern=r"^opc\.tcp://[^\s/]+(:\d+)?(/\S*)?$",
        description="opc.tcp://HOST:PORT/PATH",
    )
    security: SecurityPolicy = Field(
        "Basic256Sha256", description="policy of the connection, SignAndEncrypt unless None"
    )
    user: str | None = Field(None, description="user name; none = anonymous")
    password: SecretStr | None = Field(None, description="better by the environment or a file")
    password_file: Path | None = Field(None, description="file whose first line is the password")
    check_host_name: bool = Field(
        default=True, description="the source's certificate must name the host of the url"
    )
    publishing_interval_ms: float = Field(
        100.0, ge=1.0, le=60_000.0, description="interval at which the source sends changes"
    )
    queue_size: int = Field(
        1_000, ge=1, le=1_000_000, description="samples per signal in the source's queue"
    )
    history_s: float = Field(
        3_600.0,
        ge=0.0,
        le=2_592_000.0,
        description="how far back missed samples are read from its history; 0 = never",
    )
    warm_start_s: float = Field(
        0.0,
        ge=0.0,
        le=2_592_000.0,
        description="length of its history that is learnt at the first start, before live samples",
    )
    timeout_s: float = Field(4.0, gt=0.0, le=600.0, description="longest wait for a response")
    startup_timeout_s: float = Field(
        10.0,
        ge=0.0,
        le=2_592_000.0,
        description="wait this long for the source at start; 0 = for ever",
    )


class NamedSourceConfig(SourceConfig):
    """One of several servers that publish signals; valves name theirs."""

    name: Name = Field(description="name by which valves refer to it")


class ServerConfig(Section):
    """The service's OPC UA server, which publishes the results."""

    url: str = Field(
        "opc.tcp://127.0.0.1:4841/valvemap/service/",
        pattern=r"^opc\.tcp://[^\s/]+:\d+(/\S*)?$",
        description="opc.tcp://ADDRESS:PORT/PATH to listen on",
    )
    host_names: tuple[str, ...] = Field(
        (), description="host names by which clients reach the server, for its certificate"
    )
    anonymous_observer: bool = Field(
        default=False, description="let anonymous users read on the secured endpoints"
    )
    min_publishing_interval_ms: float = Field(
        50.0, ge=1.0, le=60_000.0, description="shortest publishing interval that a client may have"
    )
    results_interval_ms: float = Field(
        0.0,
        ge=0.0,
        le=60_000.0,
        description="shortest time between two results of a valve in its single variables; Frame "
        "has them all",
    )


class SecurityConfig(Section):
    """Certificates and users."""

    pki: Path = Field(Path("data/pki/service"), description="folder of certificates and keys")
    users: Path = Field(Path("data/users.json"), description="users and hashed passwords")
    require_crl: bool = Field(
        default=True,
        description="a certificate of an authority needs its revocation list; a self-signed one"
        " does not",
    )
