"""Application certificates as they are read and named (OPC UA Part 6, 6.2.2)."""

import datetime as dt
import hashlib
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import serialization

from guarded_opcua.errors import CertificateError
from guarded_opcua.logs import escaped

KEY_BITS = 2048
WARN_DAYS = 30


def thumbprint(certificate: x509.Certificate | bytes) -> str:
    """Return the SHA-1 of the DER form in hex, OPC UA's name of a certificate; not for security."""
    return hashlib.sha1(_der(certificate), usedforsecurity=False).hexdigest()


def fingerprint(certificate: x509.Certificate | bytes) -> str:
    """Return the SHA-256 of the DER form in hex, which identifies the certificate securely."""
    return hashlib.sha256(_der(certificate)).hexdigest()


def expiry_warning(certificate: x509.Certificate, now: dt.datetime | None = None) -> str:
    """Return a warning if a certificate expires within 30 days, else ''."""
    left = certificate.not_valid_after_utc - (now or dt.datetime.now(dt.UTC))
    if left >= dt.timedelta(days=WARN_DAYS):
        return ""
    name = escaped(certificate.subject.rfc4514_string())
    if left < dt.timedelta(0):
        return f"the certificate {name} expired on {certificate.not_valid_after_utc:%Y-%m-%d}"
    return f"the certificate {name} expires on {certificate.not_valid_after_utc:%Y-%m-%d}"


def load_certificate(file: Path) -> x509.Certificate:
    """Read a certificate in DER or PEM form.

    Raises
    ------
    CertificateError
        if the file cannot be read or is not a certificate.
    """
    try:
        content = file.read_bytes()
        if content.startswith(b"-----BEGIN"):
            return x509.load_pem_x509_certificate(content)
        return x509.load_der_x509_certificate(content)
    except OSError as error:
        raise CertificateError(f"{file}: cannot be read: {error.strerror}") from error
    except (ValueError, x509.InvalidVersion) as error:
        raise CertificateError(f"{file}: not an X.509 certificate (DER or PEM)") from error


def _der(certificate: x509.Certificate | bytes) -> bytes:
    if isinstance(certificate, x509.Certificate):
        return certificate.public_bytes(serialization.Encoding.DER)
    return certificate
