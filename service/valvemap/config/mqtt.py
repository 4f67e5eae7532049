"""Settings of the Sparkplug B publisher over MQTT."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal, Self

from pydantic import Field, model_validator

from valvemap.config.sections import Section
from valvemap.vocabulary.commands import BY_MQTT

_URL: Final = r"^(mqtts?)://([^\s/:@\[\]]+|\[[0-9A-Fa-f:.]+\])(?::(\d{1,5}))?$"
_PORTS: Final = {"mqtt": 1883, "mqtts": 8883}
_LOOPBACK: Final = ("localhost", "127.0.0.1", "::1")
_Topic = Annotated[
    str, Field(pattern=r"^[^/+#\x00-\x20]+( [^/+#\x00-\x20]+)*$", max_length=64)
]  # words separated by a space
_Pattern = Annotated[str, Field(min_length=1, max_length=200)]
if TYPE_CHECKING:
    _Command = str
else:
    _Command = Literal[BY_MQTT]


class MqttConfig(Section):
    """Where `valvemap mqtt` sends results, as Sparkplug B."""

    broker: str = Field(
        "mqtt://127.0.0.1:1883",
        pattern=_URL,
        description="mqtt://HOST:PORT, or mqtts://HOST:PORT with TLS",
    )
    group: _Topic = Field("valvemap", description="group of the edge node, part of every topic")
    edge_node: _Topic = Field("service", description="the edge node; each valve is a device of it")
    client_id: str | None = Field(
        None,
        min_length=1,
        max_length=128,
        description="MQTT client identifier; none = valvemap-GROUP-EDGE_NODE",
    )
    primary_host: _Topic | None = Field(
        None,
        description="host application that must be online; values wait for it; none = not awaited",
    )
    user: str | None = Field(None, min_length=1, description="user name; none = no log-in")
    password_file: Path | None = Field(None, description="file whose first line is the password")
    ca_file: Path | None = Field(
        None, description="trusted certificate authorities (PEM); none = the system's list"
    )
    certificate_file: Path | None = Field(None, description="our certificate (PEM), if asked for")
    key_file: Path | None = Field(None, description="its key (PEM)")
    variables: tuple[_Pattern, ...] = Field(
        ("*",),
        min_length=1,
        description="names of the variables sent, such as Auto.* or *.Residual, without the "
        "valve's name; Service.* of the service",
    )
    structure: Literal["flat", "templates"] = Field(
        "flat",
        description="flat: a metric for each variable; templates: each valve is one metric, the "
        "instance of a template",
    )
    commands: tuple[_Command, ...] = Field(
        (),
        description="commands that MQTT clients may give, with the rights of our log-in at the "
        "service: demand, acknowledge; none = no client can command a valve",
    )
    command_max_age_s: float = Field(
        5.0,
        ge=0.5,
        le=600.0,
        description="greatest difference between a command's timestamp and this machine's clock",
    )
    interval_s: float = Field(
        1.0, ge=0.1, le=3_600.0, description="interval at which changes are sent"
    )
    most_waiting: int = Field(
        100_000,
        ge=1_000,
        le=10_000_000,
        description="most values waiting for the broker; above it the oldest is dropped and "
        "counted",
    )
    keep_alive_s: int = Field(
        30,
        ge=5,
        le=3_600,
        description="the broker closes the connection after one and a half "
        "of this without a packet",
    )
    timeout_s: float = Field(10.0, gt=0.0, le=600.0, description="longest wait for a response")

    @property
    def tls(self) -> bool:
        """Whether the connection is encrypted, and the broker's certificate checked."""
        return self.broker.startswith("mqtts:")

    @property
    def address(self) -> tuple[str, int]:
        """Host and port.

        >>> MqttConfig(broker="mqtts://broker.plant").address
        ('broker.plant', 8883)
        """
        matched = re.match(_URL, self.broker)
        assert matched is not None  # noqa: S101 - the field's own pattern
        scheme, host, port = matched.groups()
        return host.strip("[]"), int(port or _PORTS[scheme])

    @model_validator(mode="after")
    def _fits(self) -> Self:
        host, port = self.address
        if not 0 < port < 65_536:
            raise ValueError(f"broker = {self.broker!r}: its port must be 1 to 65535")
        if (self.user is None) != (self.password_file is None):
            raise ValueError("user and password_file belong together")
        if (self.certificate_file is None) != (self.key_file is None):
            raise ValueError("certificate_file and key_file belong together")
        if not self.tls and (self.ca_file or self.certificate_file):
            raise ValueError("ca_file and certificate_file need broker = mqtts://…")
        if not self.tls and self.user is not None and host not in _LOOPBACK:
            raise ValueError("a password on mqtt:// can be read on the way: mqtts:// is needed")
        if self.commands and self.user is None and self.certificate_file is None:
            raise ValueError(
                "commands need user and password_file, or certificate_file: the broker's accounts "
                "and access list decide who may send commands"
            )
        return self
