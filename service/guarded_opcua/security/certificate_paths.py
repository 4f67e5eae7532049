"""From a certificate to one that we trust: paths, built and validated (RFC 5280, 6; Part 4, 6.1.3).

``cryptography``'s own verifier is for TLS: it knows neither certificates that are trusted by
themselves, as nearly all OPC UA applications have them, nor revocation lists, nor status codes.
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
_MAX_SIGNATURES = 60  # checked for one certificate; 0.05 ms each, 0.6 ms with the longest keys

Path = tuple[x509.Certificate, ...]


@dataclass(frozen=True)
class TrustLists:
    """Whom we trust.

    Attributes
    ----------
    trusted
        Applications, or authorities whose applications, we let in.
    issuers
        Authorities that only complete a path.
    revocations
        Revocation lists.
    unreadable
        What is wrong with files that should be revocation lists.
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
    """Find a path on which somebody is trusted and all is well.

    Authorities may share a name: every path is tried. If none will do, the reason is that of the
    path that came furthest.

    Parameters
    ----------
    certificate
        What was shown.
    shown
        What was sent along.
    lists
        Issuers and revocation lists.
    is_trusted
        Says whether a certificate makes the path trusted that it is part of.
    use
        What it was shown for.
    now
        The time.
    require_crl
        Every issuer needs a revocation list.

    Returns
    -------
    datetime
        Until when all certificates and lists on the path hold.

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
    """Check that a certificate holds now.

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
    """All ways up from a certificate, each as far as issuers are known."""
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
    """Who issued whom: each pair once, and so many in all; a stranger sends what it likes."""

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
            return True  # the signature proves nothing; the rules for each link refuse it
        certificate.verify_directly_issued_by(issuer)
    except (*UNREADABLE, InvalidSignature):
        return False
    return True


def _is_self_signed(certificate: x509.Certificate) -> bool:
    return certificate.issuer == certificate.subject and _issued(certificate, certificate)


def _check_complete(path: Path, *, may_be_open: bool) -> None:
    """Check that a path ends at a root; one that is trusted itself may do without."""
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
        # whom it revokes is unknown: better to say so and let nobody in by it
        raise CertificateRefused(_Codes.BadCertificateRevocationUnknown, lists.unreadable[0])
    until = check_revocation(path, lists.revocations, now, require_crl=require_crl)
    return min(until, *(link.not_valid_after_utc for link in path))


def _check_length(issuer: x509.Certificate, below: Path) -> None:
    """Check the pathLenConstraint: how many authorities may stand between."""
    constraints = extension(issuer, x509.BasicConstraints)
    allowed = None if constraints is None else constraints.path_length
    between = sum(link.subject != link.issuer for link in below)
    if allowed is not None and between > allowed:
        raise CertificateRefused(
            _Codes.BadCertificateIssuerUseNotAllowed,
            f"the issuer {name_of(issuer)} may have {allowed} authorities below it, "
            f"not {between} (pathLenConstraint)",
        )
