# ruff: noqa: INP001 - a script on its own
"""Passwords and certificates of `docker compose --profile fleet`: made once, kept in volumes.

``secrets_of_kafka.py KAFKA OURS HOST...``: the folder KAFKA gets what the broker reads (its key and
certificate for HOST..., the users), OURS the password of each user and whom to trust.
"""

import datetime as dt
import ipaddress
import os
import secrets
import sys
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec

USERS = ("topics", "collect", "work", "serve")
YEARS = 10
KEYSTORE, JAAS, AUTHORITY = "broker.pem", "jaas.conf", "ca.pem"


def main(kafka: Path, ours: Path, hosts: list[str]) -> None:
    """Make all files, unless they exist."""
    if (kafka / JAAS).exists():
        return
    ours.mkdir(parents=True, exist_ok=True)
    passwords = {user: secrets.token_urlsafe(24) for user in USERS}
    for user, password in passwords.items():
        write(ours / f"{user}-password", password + "\n", 0o600)
    keystore, authority = certificates(hosts)
    write(ours / AUTHORITY, authority, 0o644)
    # The broker runs under another user id; only its container mounts this volume.
    write(kafka / KEYSTORE, keystore, 0o644)
    users = "".join(f' user_{user}="{password}"' for user, password in passwords.items())
    login = "org.apache.kafka.common.security.plain.PlainLoginModule required"
    write(kafka / JAAS, f"clients.KafkaServer {{ {login}{users}; }};\n", 0o644)


def certificates(hosts: list[str]) -> tuple[str, str]:
    """The broker's key and certificate, and the authority behind it, whose key is not kept."""
    authority, own = (
        ec.generate_private_key(ec.SECP256R1()),
        ec.generate_private_key(ec.SECP256R1()),
    )
    issuer = named("valvemap fleet")
    root = signed(
        issuer, authority, issuer, authority, x509.BasicConstraints(ca=True, path_length=0)
    )
    names = x509.SubjectAlternativeName([alternative(host) for host in hosts])
    broker = signed(named(hosts[0]), own, issuer, authority, names)
    key = own.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )
    chain = broker.public_bytes(serialization.Encoding.PEM)
    trusted = root.public_bytes(serialization.Encoding.PEM).decode()
    return (key + chain).decode() + trusted, trusted


def signed(
    subject: x509.Name,
    key: ec.EllipticCurvePrivateKey,
    issuer: x509.Name,
    by: ec.EllipticCurvePrivateKey,
    extension: x509.ExtensionType,
) -> x509.Certificate:
    """Return a certificate with one extension."""
    now = dt.datetime.now(dt.UTC)
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - dt.timedelta(days=1))
        .not_valid_after(now + dt.timedelta(days=365 * YEARS))
        .add_extension(extension, critical=isinstance(extension, x509.BasicConstraints))
    )
    return builder.sign(by, hashes.SHA256())


def named(name: str) -> x509.Name:
    """Return a name of one part."""
    return x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])


def alternative(host: str) -> x509.GeneralName:
    """Return a host as certificates name it."""
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def write(file: Path, text: str, mode: int) -> None:
    """Write a file that is never readable by others than its mode says."""
    with os.fdopen(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, mode), "w") as out:
        out.write(text)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:])
