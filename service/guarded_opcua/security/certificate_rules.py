"""Rules for single certificates, independent of the path (RFC 5280, 4; OPC UA Part 6, 6.2)."""

from enum import Enum
from typing import TypeVar

from asyncua import ua
from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, ExtensionOID

from guarded_opcua.errors import CertificateError
from guarded_opcua.logs import escaped
from guarded_opcua.security.certificates import KEY_BITS, thumbprint

_Codes = ua.StatusCodes
E = TypeVar("E", bound=x509.ExtensionType)
_MAX_SHOWN = 5  # certificates that a peer may send: its own and those of its issuers
_MAX_BYTES = 16 * 1024
MAX_KEY_BITS = 8_192  # bounds the cost of a verification
_MIN_CURVE_BITS = 256  # as strong as the symmetric keys of the security policies
_STRONG_HASHES = (hashes.SHA256, hashes.SHA384, hashes.SHA512)
_CRITICAL_UNDERSTOOD = {
    ExtensionOID.BASIC_CONSTRAINTS,
    ExtensionOID.KEY_USAGE,
    ExtensionOID.EXTENDED_KEY_USAGE,
    ExtensionOID.SUBJECT_ALTERNATIVE_NAME,
    ExtensionOID.NAME_CONSTRAINTS,
    ExtensionOID.CERTIFICATE_POLICIES,  # all policies are accepted
}
UNREADABLE = (
    ValueError,
    TypeError,
    UnsupportedAlgorithm,
    x509.InvalidVersion,
    x509.DuplicateExtension,
    x509.UnsupportedGeneralNameType,
)


class Use(Enum):
    """Use of a certificate."""

    CLIENT = "client"
    SERVER = "server"
    USER = "user"


_EXTENDED_USES = {
    Use.CLIENT: ExtendedKeyUsageOID.CLIENT_AUTH,
    Use.SERVER: ExtendedKeyUsageOID.SERVER_AUTH,
    Use.USER: ExtendedKeyUsageOID.CLIENT_AUTH,
}


class CertificateRefused(CertificateError):  # noqa: N818 - it says what happened
    """A peer's certificate was refused; ``code`` is the OPC UA status code of the reason."""

    def __init__(self, code: int, sentence: str) -> None:
        super().__init__(sentence)
        self.code = code


def parse(der: bytes) -> tuple[x509.Certificate, list[x509.Certificate]]:
    """Parse the certificate of a peer, optionally followed by those of its issuers.

    Raises
    ------
    CertificateRefused
        BadCertificateInvalid.
    """
    if not der or len(der) > _MAX_BYTES:
        raise CertificateRefused(_Codes.BadCertificateInvalid, "no certificate, or one too large")
    found: list[x509.Certificate] = []
    try:
        while der and len(found) < _MAX_SHOWN:
            size = _der_size(der)
            found.append(x509.load_der_x509_certificate(der[:size]))
            der = der[size:]
        for certificate in found:
            read_through(certificate)
    except (*UNREADABLE, IndexError) as error:
        raise CertificateRefused(
            _Codes.BadCertificateInvalid, "what the peer shows is no X.509 certificate"
        ) from error
    return found[0], found[1:]


def read_through(certificate: x509.Certificate) -> None:
    """Parse all lazily parsed fields, so that a malformed certificate is detected immediately.

    Raises
    ------
    ValueError
        or another exception of ``UNREADABLE``.
    """
    certificate.extensions  # noqa: B018
    certificate.subject.rfc4514_string()
    certificate.issuer.rfc4514_string()
    certificate.not_valid_before_utc  # noqa: B018
    certificate.not_valid_after_utc  # noqa: B018


def first_certificate(der: bytes) -> bytes:
    """Return the first certificate of a chain, or the input if it is malformed."""
    try:
        return der[: _der_size(der)]
    except (ValueError, IndexError):
        return der


def name_of(certificate: x509.Certificate) -> str:
    """Return subject and thumbprint in one printable line."""
    return f"{escaped(certificate.subject.rfc4514_string())} ({thumbprint(certificate)[:16]})"


def check_own_rules(certificate: x509.Certificate, use: Use) -> None:
    """Check the rules for an end-entity certificate.

    Raises
    ------
    CertificateRefused
    """
    name = f"the certificate {name_of(certificate)}"
    check_strength(certificate, name)
    if not isinstance(certificate.public_key(), rsa.RSAPublicKey):
        raise CertificateRefused(
            _Codes.BadCertificatePolicyCheckFailed,
            f"{name} needs an RSA key: the security policies here are for RSA",
        )
    _check_critical(certificate, name)
    usage = extension(certificate, x509.KeyUsage)
    if use is Use.USER:
        if usage is not None and not usage.digital_signature:
            raise CertificateRefused(
                _Codes.BadCertificateUseNotAllowed,
                f"{name} may not be used to sign (KeyUsage without digitalSignature)",
            )
    elif usage is None or not (usage.digital_signature and usage.key_encipherment):
        raise CertificateRefused(
            _Codes.BadCertificateUseNotAllowed,
            f"{name} may not be used to sign and to encipher keys (KeyUsage)",
        )
    if not allows(certificate, use):
        raise CertificateRefused(
            _Codes.BadCertificateUseNotAllowed,
            f"{name} may not be used by a {use.value} (ExtendedKeyUsage)",
        )


def check_issuer_rules(issuer: x509.Certificate, use: Use) -> None:
    """Check the rules for an issuer's certificate.

    Raises
    ------
    CertificateRefused
    """
    name = f"the issuer {name_of(issuer)}"
    check_strength(issuer, name)
    _check_critical(issuer, name)
    constraints, usage = extension(issuer, x509.BasicConstraints), extension(issuer, x509.KeyUsage)
    reason = None
    if constraints is None or not constraints.ca:
        reason = "is no authority (BasicConstraints)"
    elif usage is None or not usage.key_cert_sign:
        reason = "may not sign certificates (KeyUsage without keyCertSign)"
    elif not allows(issuer, use):
        reason = f"may not certify a {use.value} (ExtendedKeyUsage)"
    if reason is not None:
        raise CertificateRefused(_Codes.BadCertificateIssuerUseNotAllowed, f"{name} {reason}")


def check_strength(certificate: x509.Certificate, name: str) -> None:
    """Check key and signature algorithm.

    Raises
    ------
    CertificateRefused
        BadCertificatePolicyCheckFailed.
    """
    reason = None
    try:
        key = certificate.public_key()
        if isinstance(key, rsa.RSAPublicKey):
            if not KEY_BITS <= key.key_size <= MAX_KEY_BITS:
                reason = f"needs an RSA key of {KEY_BITS} to {MAX_KEY_BITS} bits"
        elif not isinstance(key, ec.EllipticCurvePublicKey) or key.key_size < _MIN_CURVE_BITS:
            reason = "has a key of another kind than RSA, or a curve that is too small"
        if not is_strong(certificate.signature_hash_algorithm):
            reason = reason or "is not signed with SHA-256 or better"
    except UNREADABLE:
        reason = "has a key or signature of an unknown kind"
    if reason is not None:
        raise CertificateRefused(_Codes.BadCertificatePolicyCheckFailed, f"{name} {reason}")


def is_strong(algorithm: hashes.HashAlgorithm | None) -> bool:
    """Return whether a signature hash is secure (MD5 and SHA-1 are not)."""
    return isinstance(algorithm, _STRONG_HASHES)


def allows(certificate: x509.Certificate, use: Use) -> bool:
    """Return whether the ExtendedKeyUsage, if present, allows a use."""
    usages = extension(certificate, x509.ExtendedKeyUsage)
    wanted = {_EXTENDED_USES[use], ExtendedKeyUsageOID.ANY_EXTENDED_KEY_USAGE}
    return usages is None or not wanted.isdisjoint(usages)


def extension(certificate: x509.Certificate, kind: type[E]) -> E | None:
    """Return an extension of a certificate, None if it is absent."""
    try:
        return certificate.extensions.get_extension_for_class(kind).value
    except x509.ExtensionNotFound:
        return None


def _check_critical(certificate: x509.Certificate, name: str) -> None:
    if certificate.version is not x509.Version.v3:
        raise CertificateRefused(_Codes.BadCertificateInvalid, f"{name} is not of version 3")
    unknown = [
        held.oid.dotted_string
        for held in certificate.extensions
        if held.critical and held.oid not in _CRITICAL_UNDERSTOOD
    ]
    if unknown:
        raise CertificateRefused(
            _Codes.BadCertificateInvalid,
            f"{name} has a critical extension that is not understood here: {unknown[0]}",
        )


def _der_size(der: bytes) -> int:
    if der[0] != 0x30:
        raise ValueError("not a DER sequence")
    if der[1] < 0x80:
        return 2 + der[1]
    count = der[1] & 0x7F
    return 2 + count + int.from_bytes(der[2 : 2 + count], "big")
