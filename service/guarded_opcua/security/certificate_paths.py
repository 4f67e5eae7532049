"""Certificate paths to a trusted certificate: building and validation (RFC 5280, 6; Part 4, 6.1.3).

The verifier of ``cryptography`` is made for TLS: it supports neither directly trusted end-entity
certificates, which most OPC UA applications use, nor revocation lists or OPC UA status codes.
"""

import datetime as dt
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from asyncua import ua
from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric import rsa

from guarded_opcua.logs import escaped
from guarded_opcua.security.certificate_rules import (
    MAX_KEY_BITS,
    UNREADABLE,
    CertificateRefused,
    Use,
    check_issuer_rules,
    extension,
    is_strong,
    name_of,
)
from guarded_opcua.security.name_constraints import forbidden_name
from guarded_opcua.security.revocation import (
    CLOCK_SKEW,
    REQUIRE_CRL,
    RevocationList,
    check_revocation,
)

_Codes = ua.StatusCodes
_LONGEST_PATH = 6  # a root and five certificates below it
_MAX_SIGNATURES = 60  # verified per certificate; 0.05 ms each, 0.6 ms with the longest keys

Path = tuple[x509.Certificate, ...]


@dataclass(frozen=True)
class TrustLists:
    """Trusted certificates, issuers and revocation lists.

    Attributes
    ----------
    trusted
        Trusted applications, and authorities whose applications are trusted.
    issuers
        Authorities that complete a path but are not trusted.
    revocations
        Revocation lists.
    unreadable
        Errors of files that are not valid revocation lists.
    """

    trusted: frozenset[x509.Certificate] = frozenset()
    issuers: tuple[x509.Certificate, ...] = ()
    revocations: tuple[RevocationList, ...] = ()
    unreadable: tuple[str, ...] = ()


def check_path(
    certificate: x509.Certificate,
    shown: Sequence[x509.Certificate],
    lists: TrustLists,
    is_trusted: Callable[[x509.Certificate], bool],
    use: Use,
    now: dt.datetime,
    *,
    require_crl: bool,
) -> dt.datetime:
    """Find a valid path that contains a trusted certificate.

    Authorities may share a name, so every path is tried. If none is valid, the reason of a complete
    path is raised in preference to that of an incomplete one.

    Parameters
    ----------
    certificate
        The peer's certificate.
    shown
        Further certificates of the peer's chain.
    lists
        Issuers and revocation lists.
    is_trusted
        Returns whether a certificate makes its path trusted.
    use
        Use of the certificate.
    now
        Time of the validation.
    require_crl
        Require a revocation list of every issuer.

    Returns
    -------
    datetime
        Earliest expiry of the certificates and revocation lists used.

    Raises
    ------
    CertificateRefused
    """
    reasons: list[CertificateRefused] = []
    for path in _paths(certificate, [*shown, *lists.trusted, *lists.issuers]):
        if not any(is_trusted(link) for link in path):
            continue
        try:
            _check_complete(path, may_be_open=not require_crl and is_trusted(certificate))
            return _check_links(path, lists, use, now, require_crl=require_crl)
        except CertificateRefused as refused:
            reasons.append(refused)
    if reasons:
        raise min(reasons, key=lambda reason: reason.code == _Codes.BadCertificateChainIncomplete)
    raise CertificateRefused(
        _Codes.BadCertificateUntrusted, f"the certificate {name_of(certificate)} is not trusted"
    )


def check_time(certificate: x509.Certificate, now: dt.datetime, code: int) -> None:
    """Check the validity period of a certificate.

    Raises
    ------
    CertificateRefused
        with the code.
    """
    begins, ends = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    if not begins - CLOCK_SKEW <= now <= ends:
        raise CertificateRefused(
            code,
            f"the certificate {name_of(certificate)} is valid from {begins:%Y-%m-%d} "
            f"to {ends:%Y-%m-%d}",
        )


def _paths(certificate: x509.Certificate, pool: Sequence[x509.Certificate]) -> Iterator[Path]:
    """Yield all paths upwards from a certificate, each as far as issuers are known."""
    by_name: dict[x509.Name, dict[x509.Certificate, None]] = defaultdict(dict)
    for known in pool:
        by_name[known.subject].setdefault(known)
    signatures = _Signatures()
    waiting: list[Path] = [(certificate,)]
    while waiting:
        path = waiting.pop()
        top = path[-1]
        if top.issuer == top.subject and signatures.issued(top, top):
            yield path
            continue
        named = by_name.get(top.issuer, {}) if len(path) < _LONGEST_PATH else {}
        further = [i for i in named if i not in path and signatures.issued(i, top)]
        waiting += [(*path, issuer) for issuer in reversed(further)]
        if not further:
            yield path


class _Signatures:
    """Cached signature checks of (issuer, certificate) pairs; their number is limited."""

    def __init__(self) -> None:
        self._known: dict[tuple[x509.Certificate, x509.Certificate], bool] = {}

    def issued(self, issuer: x509.Certificate, certificate: x509.Certificate) -> bool:
        pair = issuer, certificate
        if pair not in self._known:
            if len(self._known) >= _MAX_SIGNATURES:
                return False
            self._known[pair] = _issued(issuer, certificate)
        return self._known[pair]


def _issued(issuer: x509.Certificate, certificate: x509.Certificate) -> bool:
    if certificate.issuer != issuer.subject:
        return False
    try:
        key = issuer.public_key()
        if isinstance(key, rsa.RSAPublicKey) and key.key_size > MAX_KEY_BITS:
            return False
        if not is_strong(certificate.signature_hash_algorithm):
            return True  # a weak signature proves nothing; check_strength refuses it
        certificate.verify_directly_issued_by(issuer)
    except (*UNREADABLE, InvalidSignature):
        return False
    return True


def _is_self_signed(certificate: x509.Certificate) -> bool:
    return certificate.issuer == certificate.subject and _issued(certificate, certificate)


def _check_complete(path: Path, *, may_be_open: bool) -> None:
    """Check that a path ends at a root, unless ``may_be_open``."""
    own, top = path[0], path[-1]
    if _is_self_signed(top):
        return
    if top.issuer == top.subject:
        raise CertificateRefused(
            _Codes.BadCertificateInvalid, f"the signature of {name_of(top)} is wrong"
        )
    if not may_be_open:
        raise CertificateRefused(
            _Codes.BadCertificateChainIncomplete,
            f"of the certificate {name_of(own)} the issuer {escaped(top.issuer.rfc4514_string())} "
            f"is missing: put its certificate among the issuers (a certificate that is trusted "
            f"itself does without if {REQUIRE_CRL} = false)",
        )


def _check_links(
    path: Path, lists: TrustLists, use: Use, now: dt.datetime, *, require_crl: bool
) -> dt.datetime:
    own, issuers = path[0], path[1:]
    check_time(own, now, _Codes.BadCertificateTimeInvalid)
    for issuer in issuers:
        check_time(issuer, now, _Codes.BadCertificateIssuerTimeInvalid)
    for number, issuer in enumerate(issuers):
        check_issuer_rules(issuer, use)
        _check_length(issuer, issuers[:number])
    if name := forbidden_name(path):
        raise CertificateRefused(
            _Codes.BadCertificateIssuerUseNotAllowed,
            f"an issuer of the certificate {name_of(own)} may not issue for the name "
            f"{escaped(name)} (NameConstraints)",
        )
    if issuers and lists.unreadable:
        # the issuer may have revoked any certificate: fail closed
        raise CertificateRefused(_Codes.BadCertificateRevocationUnknown, lists.unreadable[0])
    until = check_revocation(path, lists.revocations, now, require_crl=require_crl)
    return min(until, *(link.not_valid_after_utc for link in path))


def _check_length(issuer: x509.Certificate, below: Path) -> None:
    """Check the pathLenConstraint, the number of authorities below the issuer."""
    constraints = extension(issuer, x509.BasicConstraints)
    allowed = None if constraints is None else constraints.path_length
    between = sum(link.subject != link.issuer for link in below)
    if allowed is not None and between > allowed:
        raise CertificateRefused(
            _Codes.BadCertificateIssuerUseNotAllowed,
            f"the issuer {name_of(issuer)} may have {allowed} authorities below it, "
            f"not {between} (pathLenConstraint)",
        )
