"""The certificate and key of an application, created and renewed."""

import datetime as dt
import ipaddress
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from guarded_opcua.errors import CertificateError
from guarded_opcua.logs import bounded_logger
from guarded_opcua.security.certificates import KEY_BITS, load_certificate
from guarded_opcua.security.pki_folders import Pki
from guarded_opcua.security.whole_files import write_owner_only, write_readable

_log = bounded_logger(__name__)

VALID_DAYS = 730


@dataclass(frozen=True)
class OwnCertificate:
    """Files of an application's certificate (DER) and private key (PEM, readable by its owner)."""

    certificate: Path
    key: Path


def ensure_certificate(
    pki: Pki, application_uri: str, host_names: tuple[str, ...], name: str
) -> OwnCertificate:
    """Return this application's certificate, creating or renewing it if needed.

    A self-signed certificate is renewed (with the same key) if it has expired or does not name the
    application or all of the hosts. A certificate signed by an authority is never changed.

    Parameters
    ----------
    pki
        Folders; created if missing.
    application_uri
        Copied to the SubjectAlternativeName unchanged.
    host_names
        DNS names and IP addresses of the server.
    name
        Name of the application, and of its files in ``own``.

    Raises
    ------
    CertificateError
        if a file cannot be read or written, certificate and key do not match, or an authority's
        certificate is unsuitable.
    """
    pki.make_folders()
    paths = OwnCertificate(pki.own / f"{name}.der", pki.own / f"{name}.pem")
    key = _load_key(paths.key) if paths.key.exists() else None
    if key is not None and paths.certificate.exists():
        certificate = load_certificate(paths.certificate)
        if certificate.public_key() != key.public_key():
            raise CertificateError(f"{paths.certificate}: does not belong to {paths.key}")
        fault = _fault(certificate, application_uri, host_names)
        if fault is None:
            return paths
        if certificate.issuer != certificate.subject:
            raise CertificateError(f"{paths.certificate}: {fault}; ask its issuer for a new one")
        _log.warning("%s: %s; a new one is made, peers must trust it", paths.certificate, fault)
    try:
        if key is None:
            key = rsa.generate_private_key(public_exponent=65537, key_size=KEY_BITS)
            write_owner_only(paths.key, _key_bytes(key))
        certificate = make_certificate(key, application_uri, host_names, name)
        write_readable(paths.certificate, certificate.public_bytes(serialization.Encoding.DER))
    except OSError as error:
        raise CertificateError(f"{error.filename}: cannot be written: {error.strerror}") from error
    return paths


def make_certificate(
    key: rsa.RSAPrivateKey, application_uri: str, host_names: tuple[str, ...], name: str
) -> x509.Certificate:
    """Create a self-signed application certificate as specified in OPC UA Part 6, 6.2.2."""
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name[:64])])
    now = dt.datetime.now(dt.UTC).replace(microsecond=0)
    names: list[x509.GeneralName] = [x509.UniformResourceIdentifier(application_uri)]
    names += [_general_name(host) for host in dict.fromkeys(host_names)]
    identifier = x509.SubjectKeyIdentifier.from_public_key(key.public_key())
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - dt.timedelta(hours=1))
        .not_valid_after(now + dt.timedelta(days=VALID_DAYS))
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(
            x509.KeyUsage(
                digital_signature=True,
                content_commitment=True,
                key_encipherment=True,
                data_encipherment=True,
                key_cert_sign=True,
                key_agreement=False,
                crl_sign=False,
                encipher_only=False,
                decipher_only=False,
            ),
            critical=True,
        )
        .add_extension(
            x509.ExtendedKeyUsage(
                [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
            ),
            critical=False,
        )
        .add_extension(identifier, critical=False)
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_subject_key_identifier(identifier),
            critical=False,
        )
        .sign(key, hashes.SHA256())
    )


def _load_key(file: Path) -> rsa.RSAPrivateKey:
    try:
        key = serialization.load_pem_private_key(file.read_bytes(), password=None)
    except OSError as error:
        raise CertificateError(f"{file}: cannot be read: {error.strerror}") from error
    except (ValueError, TypeError) as error:
        raise CertificateError(f"{file}: not an unencrypted private key in PEM form") from error
    if not isinstance(key, rsa.RSAPrivateKey) or key.key_size < KEY_BITS:
        raise CertificateError(f"{file}: an RSA key of at least {KEY_BITS} bits is needed")
    return key


def _key_bytes(key: rsa.RSAPrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )


def _fault(
    certificate: x509.Certificate, application_uri: str, host_names: tuple[str, ...]
) -> str | None:
    if certificate.not_valid_after_utc <= dt.datetime.now(dt.UTC):
        return f"it expired on {certificate.not_valid_after_utc:%Y-%m-%d}"
    try:
        extension = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName)
    except x509.ExtensionNotFound:
        return "it has no SubjectAlternativeName"
    names = extension.value
    if application_uri not in names.get_values_for_type(x509.UniformResourceIdentifier):
        return f"it does not name the application {application_uri}"
    missing = [host for host in host_names if _general_name(host) not in list(names)]
    return f"it does not name the host {missing[0]}" if missing else None


def _general_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host.strip("[]")))
    except ValueError:
        return x509.DNSName(host)
