"""Revocation of certificates: revocation lists and their scope (RFC 5280, 5)."""

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from asyncua import ua
from cryptography import x509
from cryptography.x509.oid import ExtensionOID

from guarded_opcua.security.certificate_rules import (
    UNREADABLE,
    CertificateRefused,
    extension,
    is_strong,
    name_of,
)

_Codes = ua.StatusCodes
CLOCK_SKEW = dt.timedelta(minutes=5)  # tolerance between the local clock and the issuer's
REQUIRE_CRL = "security.require_crl"
_CRITICAL_UNDERSTOOD = {
    ExtensionOID.ISSUING_DISTRIBUTION_POINT,
    ExtensionOID.DELTA_CRL_INDICATOR,
    ExtensionOID.CRL_NUMBER,
    ExtensionOID.AUTHORITY_KEY_IDENTIFIER,
}


@dataclass(frozen=True)
class RevocationList:
    """A revocation list and its file."""

    file: Path
    content: x509.CertificateRevocationList
    _signers: dict[x509.Certificate, bool] = field(default_factory=dict, compare=False)

    def is_signed_by(self, issuer: x509.Certificate) -> bool:
        """Return whether an authority signed the list; cached, since lists may be large."""
        known = self._signers.get(issuer)
        if known is None:
            try:
                key = issuer.public_key()
                known = self.content.is_signature_valid(key)  # type: ignore[arg-type]
            except UNREADABLE:
                known = False
            self._signers[issuer] = known
        return known


def check_revocation(
    path: Sequence[x509.Certificate],
    lists: Sequence[RevocationList],
    now: dt.datetime,
    *,
    require_crl: bool,
) -> dt.datetime:
    """Check that no certificate of a path was revoked.

    A list is valid if it is signed by the issuer with cRLSign, current, complete (no delta), and
    its scope covers the certificate (not indirect). Entries of signed delta lists and of expired
    lists revoke, too.

    Parameters
    ----------
    path
        From the certificate that was shown up to its root.
    lists
        All available lists.
    now
        Time of the check.
    require_crl
        Refuse a certificate whose issuer has no valid list.

    Returns
    -------
    datetime
        Earliest expiry of the lists used.

    Raises
    ------
    CertificateRefused
        Bad(Issuer)Revoked, Bad(Issuer)RevocationUnknown.
    """
    until = dt.datetime.max.replace(tzinfo=dt.UTC)
    for number, (certificate, issuer) in enumerate(pairwise(path)):
        faults, ends = [], []
        for known in lists:
            if known.content.issuer != issuer.subject:
                continue
            fault = _fault_of(known, certificate, issuer)
            if fault is None and _lists(known, certificate):
                raise CertificateRefused(
                    _Codes.BadCertificateIssuerRevoked if number else _Codes.BadCertificateRevoked,
                    f"the certificate {name_of(certificate)} was revoked ({known.file})",
                )
            fault = fault or _gap_of(known, now)
            if fault is None and known.content.next_update_utc is not None:
                ends.append(known.content.next_update_utc)
            faults.append(f"{known.file} {fault}")
        if not ends and require_crl:
            reason = f": {'; '.join(faults)}" if faults else ""
            raise CertificateRefused(
                _Codes.BadCertificateIssuerRevocationUnknown
                if number
                else _Codes.BadCertificateRevocationUnknown,
                f"whether the certificate {name_of(certificate)} was revoked is unknown: no valid "
                f"revocation list (.crl) of its issuer {name_of(issuer)}{reason}; put one beside "
                f"the certificates of the issuers, or set {REQUIRE_CRL} = false",
            )
        if ends:
            until = min(until, max(ends))
    return until


def _fault_of(
    known: RevocationList, certificate: x509.Certificate, issuer: x509.Certificate
) -> str | None:
    """Return why a list does not apply to a certificate, None if it does."""
    content = known.content
    try:
        usage = extension(issuer, x509.KeyUsage)
        if not known.is_signed_by(issuer):
            return "is not signed by it"
        if usage is None or not usage.crl_sign:
            return "is signed by who may not do so (KeyUsage without cRLSign)"
        if not is_strong(content.signature_hash_algorithm):
            return "is not signed with SHA-256 or better"
        for held in content.extensions:
            if held.critical and held.oid not in _CRITICAL_UNDERSTOOD:
                return f"has a critical extension {held.oid.dotted_string}"
        return None if _covers(content, certificate) else "speaks of other certificates"
    except UNREADABLE:
        return "cannot be understood"


def _covers(content: x509.CertificateRevocationList, certificate: x509.Certificate) -> bool:
    try:
        scope = content.extensions.get_extension_for_class(x509.IssuingDistributionPoint).value
    except x509.ExtensionNotFound:
        return True
    constraints = extension(certificate, x509.BasicConstraints)
    is_authority = constraints is not None and constraints.ca
    if (
        scope.indirect_crl
        or scope.only_contains_attribute_certs
        or scope.only_some_reasons is not None
        or scope.relative_name is not None
        or (scope.only_contains_user_certs and is_authority)
        or (scope.only_contains_ca_certs and not is_authority)
    ):
        return False
    if scope.full_name is None:
        return True
    points = extension(certificate, x509.CRLDistributionPoints) or ()
    return any(name in scope.full_name for point in points for name in point.full_name or ())


def _lists(known: RevocationList, certificate: x509.Certificate) -> bool:
    entry = known.content.get_revoked_certificate_by_serial_number(certificate.serial_number)
    if entry is None:
        return False
    try:
        reason = entry.extensions.get_extension_for_class(x509.CRLReason).value.reason
    except (*UNREADABLE, x509.ExtensionNotFound):
        return True
    return reason is not x509.ReasonFlags.remove_from_crl


def _gap_of(known: RevocationList, now: dt.datetime) -> str | None:
    """Return why the absence of an entry in a list is no proof of validity, None if it is."""
    content = known.content
    if any(held.oid == ExtensionOID.DELTA_CRL_INDICATOR for held in content.extensions):
        return "is a delta, not a whole list"
    if content.last_update_utc > now + CLOCK_SKEW:
        return f"holds from {content.last_update_utc:%Y-%m-%d} only"
    if content.next_update_utc is None:
        return "does not say until when it holds"
    if content.next_update_utc < now:
        return f"expired on {content.next_update_utc:%Y-%m-%d}"
    return None
