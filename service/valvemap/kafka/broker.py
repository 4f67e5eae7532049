"""Settings of all Kafka clients, and their errors as one line."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from confluent_kafka import KafkaException

from valvemap.config.secret_files import read_secret
from valvemap.errors import BrokerAway, ConfigurationError, FleetError
from valvemap.kafka.settings import BrokerConfig


def client_settings(broker: BrokerConfig) -> dict[str, Any]:
    """Return the librdkafka settings that all clients share.

    Raises
    ------
    ConfigurationError
        if a file of certificates, keys or passwords cannot be read; names the file.

    Examples
    --------
    >>> broker = BrokerConfig(addresses=("k1:9092", "k2:9092"), tls=True)
    >>> client_settings(broker)["bootstrap.servers"]
    'k1:9092,k2:9092'
    """
    named = broker.user is not None
    said: dict[str, Any] = {
        "bootstrap.servers": ",".join(broker.addresses),
        "security.protocol": ("sasl_" if named else "") + ("ssl" if broker.tls else "plaintext"),
    }
    files = {
        "ssl.ca.location": broker.ca_file,
        "ssl.certificate.location": broker.certificate_file,
        "ssl.key.location": broker.key_file,
    }
    for name, file in files.items():
        if file is not None:
            if not file.is_file():
                raise ConfigurationError(f"{file}: no such file; broker.{_FIELDS[name]} names it")
            said[name] = str(file)
    if broker.password_file is not None:
        said["sasl.mechanism"] = broker.mechanism
        said["sasl.username"] = broker.user
        said["sasl.password"] = read_secret(broker.password_file)
    return said


def silent() -> logging.Logger:
    """Logger for clients whose messages also arrive as exceptions or callbacks: it drops them."""
    quiet = logging.getLogger("librdkafka")  # not the name of a package of ours
    if not quiet.handlers:
        quiet.addHandler(logging.NullHandler())
    quiet.propagate = False
    return quiet


_FIELDS = {
    "ssl.ca.location": "ca_file",
    "ssl.certificate.location": "certificate_file",
    "ssl.key.location": "key_file",
}


@contextmanager
def speaking_to(broker: BrokerConfig) -> Iterator[None]:
    """Convert exceptions of librdkafka to one line that names the brokers."""
    try:
        yield
    except KafkaException as error:
        kind = BrokerAway if _name(error) in _AWAY else FleetError
        raise kind(f"broker {','.join(broker.addresses)}: {reason(error)}") from None


def reason(error: KafkaException) -> str:
    """Short text of a Kafka error."""
    kafka = error.args[0] if error.args else error
    text = kafka.str() if hasattr(kafka, "str") else str(kafka)
    name = _name(error)
    if name in _AWAY:
        return "cannot be reached: is it running, and broker.addresses right?"
    return (text.splitlines() or [name])[0]


def _name(error: KafkaException) -> str:
    kafka = error.args[0] if error.args else error
    return kafka.name() if hasattr(kafka, "name") else ""


_AWAY = {"_TRANSPORT", "_ALL_BROKERS_DOWN", "_TIMED_OUT", "_RESOLVE"}
