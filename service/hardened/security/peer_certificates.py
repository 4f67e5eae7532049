"""Whether a peer's certificate is one we trust (OPC UA Part 4, 6.1.3)."""

import datetime as dt
import functools
from collections.abc import Iterable
from pathlib import Path

from asyncua import ua
from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric import rsa

from service.hardened.errors import CertificateError
from service.hardened.logs import bounded_logger
from service.hardened.security.certificates import (
    KEY_BITS,
    Pki,
    certificate_files,
    load_certificate,
    reject,
    thumbprint,
)

_log = bounded_logger(__name__)
_Codes = ua.StatusCodes
_MAX_CHAIN = 5
_MAX_BYTES = 16 * 1024
_MAX_KEY_BITS = 8_192
_CLOCK_SKEW = dt.timedelta(minutes=5)


class CertificateRefused(CertificateError):  # noqa: N818 - it says what happened
    """A peer's certificate is not accepted; ``code`` is the OPC UA status code of the reason."""

    def __init__(self, code: int, sentence: str) -> None:
        super().__init__(sentence)
        self.code = code


def check_peer(pki: Pki, der: bytes, application_uri: str | None = None) -> x509.Certificate:
    """Check the certificate that a peer shows; an unknown one lands in ``rejected``.

    Parameters
    ----------
    pki
        Whom we trust.
    der
        What the peer sent: its certificate, perhaps followed by those of its issuers.
    application_uri
        What the peer says it is, if it has said so.

    Raises
    ------
    CertificateRefused
        with a sentence that names the certificate and the reason.
    """
    certificate, chain = _parse(der)
    name = f"{certificate.subject.rfc4514_string()} ({thumbprint(certificate)[:16]})"
    _check_key(certificate, name)
    path = _path(certificate, [*chain, *_load(pki.trusted), *_load(pki.issuers)])
    trusted = {thumbprint(known) for known in _load(pki.trusted)}
    if not any(thumbprint(link) in trusted for link in path):
        reject(pki, der)
        raise CertificateRefused(
            _Codes.BadCertificateUntrusted,
            f"the certificate {name} is not trusted; it lies in {pki.rejected}",
        )
    if not _is_complete(path) and thumbprint(certificate) not in trusted:
        raise CertificateRefused(
            _Codes.BadCertificateChainIncomplete,
            f"an issuer of the certificate {name} is missing in {pki.issuers}",
        )
    _check_times(path, name)
    _check_revocation(pki, path, name)
    if application_uri is not None and application_uri not in application_uris(certificate):
        raise CertificateRefused(
            _Codes.BadCertificateUriInvalid,
            f"the certificate {name} does not name the application {application_uri!r}",
        )
    return certificate


def application_uris(certificate: x509.Certificate) -> list[str]:
    """Return the URIs in a certificate's SubjectAlternativeName."""
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except (x509.ExtensionNotFound, ValueError):
        return []
    return names.get_values_for_type(x509.UniformResourceIdentifier)


def _parse(der: bytes) -> tuple[x509.Certificate, list[x509.Certificate]]:
    if not der or len(der) > _MAX_BYTES:
        raise CertificateRefused(_Codes.BadCertificateInvalid, "no certificate, or one too large")
    found: list[x509.Certificate] = []
    try:
        while der and len(found) < _MAX_CHAIN:
            size = _der_size(der)
            found.append(x509.load_der_x509_certificate(der[:size]))
            der = der[size:]
    except (ValueError, IndexError) as error:
        raise CertificateRefused(
            _Codes.BadCertificateInvalid, "what the peer shows is no X.509 certificate"
        ) from error
    return found[0], found[1:]


def _der_size(der: bytes) -> int:
    if der[0] != 0x30:
        raise ValueError("not a DER sequence")
    if der[1] < 0x80:
        return 2 + der[1]
    count = der[1] & 0x7F
    return 2 + count + int.from_bytes(der[2 : 2 + count], "big")


def _check_key(certificate: x509.Certificate, name: str) -> None:
    try:
        key = certificate.public_key()
    except ValueError as error:
        raise CertificateRefused(
            _Codes.BadCertificateInvalid, f"the certificate {name} has no usable key"
        ) from error
    if not isinstance(key, rsa.RSAPublicKey) or not KEY_BITS <= key.key_size <= _MAX_KEY_BITS:
        raise CertificateRefused(
            _Codes.BadCertificatePolicyCheckFailed,
            f"the certificate {name} needs an RSA key of {KEY_BITS} bits or more",
        )
    try:
        usage = certificate.extensions.get_extension_for_class(x509.KeyUsage).value
    except (x509.ExtensionNotFound, ValueError):
        return
    if not (usage.digital_signature and usage.key_encipherment):
        raise CertificateRefused(
            _Codes.BadCertificateUseNotAllowed,
            f"the certificate {name} may not be used to sign and to encipher keys",
        )


def _path(
    certificate: x509.Certificate, candidates: Iterable[x509.Certificate]
) -> list[x509.Certificate]:
    """Follow the issuers as far as they are known."""
    known = list(candidates)
    path = [certificate]
    while len(path) < _MAX_CHAIN and path[-1].issuer != path[-1].subject:
        issuer = next((other for other in known if _issued(other, path[-1])), None)
        if issuer is None:
            break
        path.append(issuer)
    return path


def _issued(issuer: x509.Certificate, certificate: x509.Certificate) -> bool:
    if issuer.subject != certificate.issuer:
        return False
    try:
        if not issuer.extensions.get_extension_for_class(x509.BasicConstraints).value.ca:
            return False
        certificate.verify_directly_issued_by(issuer)
    except (x509.ExtensionNotFound, InvalidSignature, ValueError, TypeError):
        return False
    return True


def _is_complete(path: list[x509.Certificate]) -> bool:
    return path[-1].issuer == path[-1].subject


def _check_times(path: list[x509.Certificate], name: str) -> None:
    now = dt.datetime.now(dt.UTC)
    own, issuers = path[0], path[1:]
    if not own.not_valid_before_utc - _CLOCK_SKEW <= now <= own.not_valid_after_utc:
        raise CertificateRefused(
            _Codes.BadCertificateTimeInvalid,
            f"the certificate {name} is valid from {own.not_valid_before_utc:%Y-%m-%d} "
            f"to {own.not_valid_after_utc:%Y-%m-%d}",
        )
    for link in issuers:
        if not link.not_valid_before_utc - _CLOCK_SKEW <= now <= link.not_valid_after_utc:
            raise CertificateRefused(
                _Codes.BadCertificateIssuerTimeInvalid,
                f"an issuer of the certificate {name} has expired or is not yet valid",
            )


def _check_revocation(pki: Pki, path: list[x509.Certificate], name: str) -> None:
    lists = _revocation_lists(pki)
    for number, link in enumerate(path):
        for revoked in lists:
            if revoked.issuer == link.issuer and revoked.get_revoked_certificate_by_serial_number(
                link.serial_number
            ):
                code = (
                    _Codes.BadCertificateIssuerRevoked if number else _Codes.BadCertificateRevoked
                )
                raise CertificateRefused(code, f"the certificate {name} was revoked")


def _revocation_lists(pki: Pki) -> list[x509.CertificateRevocationList]:
    lists = []
    for folder in (pki.trusted, pki.issuers):
        for file in sorted(folder.glob("*.crl")) if folder.is_dir() else ():
            try:
                content = file.read_bytes()
                is_pem = content.startswith(b"-----BEGIN")
                load = x509.load_pem_x509_crl if is_pem else x509.load_der_x509_crl
                lists.append(load(content))
            except (OSError, ValueError) as error:
                # whom it revokes is unknown: better to say so and let nobody in by it
                raise CertificateRefused(
                    _Codes.BadCertificateRevocationUnknown, f"{file}: no revocation list: {error}"
                ) from error
    return lists


def _load(folder: Path) -> tuple[x509.Certificate, ...]:
    stamps = tuple(
        (file, status.st_mtime_ns, status.st_size)
        for file in certificate_files(folder)
        for status in (file.stat(),)
    )
    return _parsed(stamps)


@functools.lru_cache(maxsize=16)
def _parsed(stamps: tuple[tuple[Path, int, int], ...]) -> tuple[x509.Certificate, ...]:
    found = []
    for file, _, _ in stamps:
        try:
            found.append(load_certificate(file))
        except CertificateError as error:
            _log.warning("%s", error)
    return tuple(found)
