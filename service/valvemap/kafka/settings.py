"""Configuration of a fleet, ``config/fleet.toml``; `docs/fleet.md` lists its fields."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator
from pydantic_settings import SettingsConfigDict

from valvemap.config.loading import load_settings
from valvemap.config.names import Name
from valvemap.config.sections import Section, SettingsFile
from valvemap.errors import ConfigurationError

Address = Annotated[str, Field(pattern=r"^[^\s:/]+:\d{1,5}$")]


class BrokerConfig(Section):
    """Where Kafka is, and how we are known there."""

    addresses: tuple[Address, ...] = Field(
        ("127.0.0.1:9092",), min_length=1, description="HOST:PORT of one or more of its brokers"
    )
    tls: bool = Field(default=False, description="encrypt, and check the broker's certificate")
    ca_file: Path | None = Field(
        None, description="trusted certificate authorities (PEM); none = the system's list"
    )
    certificate_file: Path | None = Field(None, description="our certificate (PEM), if asked for")
    key_file: Path | None = Field(None, description="its key (PEM)")
    user: str | None = Field(None, description="user name (SASL); none = by certificate, or open")
    password_file: Path | None = Field(None, description="file whose first line is the password")
    mechanism: Literal["SCRAM-SHA-512", "SCRAM-SHA-256", "PLAIN"] = Field(
        "SCRAM-SHA-512", description="how the password is shown; PLAIN only with tls"
    )
    timeout_s: float = Field(10.0, gt=0.0, le=600.0, description="longest wait for a response")

    @model_validator(mode="after")
    def _secrets_fit(self) -> Self:
        if (self.user is None) != (self.password_file is None):
            raise ValueError("user and password_file belong together")
        if (self.certificate_file is None) != (self.key_file is None):
            raise ValueError("certificate_file and key_file belong together")
        if self.mechanism == "PLAIN" and self.user is not None and not self.tls:
            raise ValueError('mechanism = "PLAIN" shows the password to anyone: tls is needed')
        if self.certificate_file is not None and not self.tls:
            raise ValueError("certificate_file: tls = true is needed")
        return self


class TopicsConfig(Section):
    """The topics: samples, commands, results, rejected and state, named after a prefix."""

    prefix: str = Field(
        "valvemap",
        pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$",
        description="their names are PREFIX.samples, .commands, .results, .rejected, .state",
    )
    partitions: int = Field(
        12, ge=1, le=1_000, description="most workers that can share the work; never changed later"
    )
    replication: int = Field(3, ge=1, le=9, description="brokers that hold each message")
    samples_h: float = Field(
        48.0,
        ge=0.1,
        le=87_600.0,
        description="how long samples, commands and rejected messages are held, h",
    )
    results_h: float = Field(24.0, ge=0.1, le=87_600.0, description="how long results are held, h")
    message_mb: float = Field(
        16.0, ge=0.1, le=100.0, description="largest message: state of a group, or a block, MB"
    )


class CatalogueConfig(Section):
    """Which valves there are: the service's configuration of each site, under one version."""

    version: int = Field(
        1, ge=1, le=2_147_483_647, description="raise it with every change of a site's valves"
    )
    sites: dict[Name, Path] = Field(
        default_factory=dict, description="site: its configuration, seen from this file's folder"
    )
    valves_per_group: int = Field(
        50, ge=1, le=1_000, description="valves that travel together; never changed later"
    )


class CollectConfig(Section):
    """Who listens to the sources."""

    spool: Path = Field(
        Path("data/spool"), description="folder of what waits for the broker, a file for each site"
    )
    commit_s: float = Field(
        0.1,
        ge=0.01,
        le=60.0,
        description="interval at which received samples are packed into blocks and stored",
    )
    most_mb: float = Field(
        2_000.0,
        ge=1.0,
        le=1e7,
        description=(
            "size of the queue for the broker, MB; above it the oldest is dropped and counted"
        ),
    )


class WorkConfig(Section):
    """The workers."""

    state: Path = Field(Path("data/fleet"), description="folder of a worker's local copies")
    commit_s: float = Field(
        0.2,
        ge=0.01,
        le=60.0,
        description="interval of commits; results are published after the commit",
    )
    results_s: float = Field(
        1.0, ge=0.0, le=3_600.0, description="source time between results; 0 = with every block"
    )
    maps_s: float = Field(
        60.0, ge=1.0, le=86_400.0, description="source time between new tables and surveys"
    )
    takeover_s: float = Field(
        8.0,
        ge=1.0,
        le=300.0,
        description="silence of a worker after which its groups are reassigned",
    )


class ServeConfig(Section):
    """Who shows the results."""

    stale_after_s: float = Field(
        5.0,
        ge=0.5,
        le=86_400.0,
        description="age of results at which a valve is Uncertain; at twice this age it is Bad",
    )
    answer_s: float = Field(
        10.0, ge=0.5, le=600.0, description="longest that an operator waits for the workers"
    )
    rejected_quiet_s: float = Field(
        600.0,
        ge=1.0,
        le=86_400.0,
        description="time without rejected messages that ends the alarm MessagesRejected, s",
    )


class FleetConfig(SettingsFile):
    """All of it: a TOML file, overridden by ``VALVEMAP_FLEET_<SECTION>__<FIELD>``."""

    model_config = SettingsConfigDict(env_prefix="VALVEMAP_FLEET_")

    broker: BrokerConfig = BrokerConfig()
    topics: TopicsConfig = TopicsConfig()
    catalogue: CatalogueConfig = CatalogueConfig()
    collect: CollectConfig = CollectConfig()
    work: WorkConfig = WorkConfig()
    serve: ServeConfig = ServeConfig()


def load_fleet(file: Path) -> FleetConfig:
    """Read a fleet's configuration; relative paths are resolved against its folder.

    Raises
    ------
    ConfigurationError
        naming file (or environment variable), field, value and the allowed values.
    """
    if not file.is_file():
        raise ConfigurationError(f"{file}: no such file; docs/fleet.md shows its content")
    config, folder = load_settings(FleetConfig, file), file.parent
    catalogue = config.catalogue
    sites = {name: folder / path for name, path in catalogue.sites.items()}
    return config.model_copy(update={"catalogue": catalogue.model_copy(update={"sites": sites})})
