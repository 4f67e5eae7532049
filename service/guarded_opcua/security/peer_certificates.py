"""Trust decisions on the certificates of peers (OPC UA Part 4, 6.1.3)."""

import datetime as dt
import ipaddress

from asyncua import ua
from cryptography import x509
from cryptography.hazmat.primitives import serialization

from guarded_opcua.clock import Clock, SystemClock
from guarded_opcua.logs import escaped
from guarded_opcua.security.certificate_paths import TrustLists, check_path, check_time
from guarded_opcua.security.certificate_rules import (
    UNREADABLE,
    CertificateRefused,
    Use,
    check_issuer_rules,
    check_own_rules,
    extension,
    name_of,
    parse,
)
from guarded_opcua.security.certificates import fingerprint, thumbprint
from guarded_opcua.security.pki_folders import Pki, reject
from guarded_opcua.security.trust_folders import Stamp, TrustFolders

CHECK_HOST_NAME = "source.check_host_name"
_Codes = ua.StatusCodes
_REMEMBERED = 1_000  # accepted certificates in the cache
_LONGEST_CHANGE = 3  # polls of constantly changing folders until they are read anyway


class PeerTrust:
    """Checks the certificates of peers against the folders of a :class:`Pki`.

    The folders are polled with every check, so that added and removed files take effect
    immediately. :meth:`look_again` and :meth:`check_again` serve the periodic check of connected
    peers.

    Parameters
    ----------
    pki
        Certificate folders; None: only user certificates that match their account are trusted.
    clock
        Clock for the validity periods of certificates and revocation lists.
    require_crl
        Refuse certificates of an authority without a valid revocation list.
    """

    def __init__(
        self, pki: Pki | None, clock: Clock | None = None, *, require_crl: bool = True
    ) -> None:
        self._pki = pki
        self._clock = clock or SystemClock()
        self._require_crl = require_crl
        self._folders = None if pki is None else TrustFolders(pki)
        self._lists = TrustLists()
        self._stamp: Stamp = ()
        self._changing = 0
        self._accepted: dict[tuple[bytes, Use, frozenset[str]], dt.datetime] = {}

    def check(
        self,
        der: bytes,
        use: Use,
        application_uri: str | None = None,
        anchors: frozenset[str] = frozenset(),
    ) -> x509.Certificate:
        """Check a certificate; that of an unknown application is stored in ``rejected``.

        Parameters
        ----------
        der
            The peer's certificate, optionally followed by those of its issuers.
        use
            Use of the certificate.
        application_uri
            ApplicationUri that the certificate must name; None: not checked.
        anchors
            For a user: thumbprints of the only certificates that make the path trusted.

        Raises
        ------
        CertificateRefused
            with a message that names the certificate and the reason.
        """
        self._read()
        certificate = self.check_again(der, use, anchors)
        if application_uri is not None and application_uri not in application_uris(certificate):
            raise CertificateRefused(
                _Codes.BadCertificateUriInvalid,
                f"the certificate {name_of(certificate)} does not name the application "
                f"{application_uri!r}",
            )
        return certificate

    def check_authority(self, authority: x509.Certificate, use: Use) -> None:
        """Check the certificate of an authority before the operator is asked to trust it.

        Raises
        ------
        CertificateRefused
        """
        check_time(authority, self._now(), _Codes.BadCertificateIssuerTimeInvalid)
        check_issuer_rules(authority, use)

    def look_again(self) -> bool:
        """Poll the folders and reload them if they are stable; return whether they are.

        While files are being written, the folders are not read, so that a partial file disconnects
        no peer.
        """
        if self._folders is None:
            return True
        stamp = self._folders.stamp()
        if stamp != self._stamp and self._changing < _LONGEST_CHANGE:
            self._stamp = stamp
            self._changing += 1
            return False
        self._changing = 0
        self._read()
        return True

    def check_again(
        self,
        der: bytes,
        use: Use,
        anchors: frozenset[str] = frozenset(),
    ) -> x509.Certificate:
        """Check a certificate against the folders as last read.

        Raises
        ------
        CertificateRefused
        """
        certificate, shown = parse(der)
        now = self._now()
        key = (der, use, anchors)
        if now < self._accepted.get(key, now):
            return certificate
        check_own_rules(certificate, use)
        lists = self._lists

        def is_trusted(link: x509.Certificate) -> bool:
            if use is Use.USER:
                return fingerprint(link) in anchors or thumbprint(link) in anchors
            return link in lists.trusted

        try:
            until = check_path(
                certificate, shown, lists, is_trusted, use, now, require_crl=self._require_crl
            )
        except CertificateRefused as refused:
            self._accepted.pop(key, None)
            if refused.code == _Codes.BadCertificateUntrusted and use is not Use.USER:
                raise self._kept(certificate) from refused
            raise
        if len(self._accepted) >= _REMEMBERED:
            self._accepted.clear()
        self._accepted[key] = until
        return certificate

    def _now(self) -> dt.datetime:
        return dt.datetime.fromtimestamp(self._clock.now() * 1e-9, dt.UTC)

    def _read(self) -> None:
        lists = TrustLists() if self._folders is None else self._folders.lists()
        if lists is not self._lists:
            self._lists = lists
            self._accepted.clear()

    def _kept(self, certificate: x509.Certificate) -> CertificateRefused:
        place = ""
        if self._pki is not None:
            reject(self._pki, certificate.public_bytes(serialization.Encoding.DER))
            place = f"; it lies in {self._pki.rejected}"
        return CertificateRefused(
            _Codes.BadCertificateUntrusted,
            f"the certificate {name_of(certificate)} is not trusted{place}",
        )


def check_host_name(certificate: x509.Certificate, host: str) -> None:
    """Check that a server's certificate names the host of its URL.

    Raises
    ------
    CertificateRefused
        BadCertificateHostNameInvalid.
    """
    names = extension(certificate, x509.SubjectAlternativeName) or x509.SubjectAlternativeName([])
    try:
        address = ipaddress.ip_address(host)
        known = [str(name) for name in names.get_values_for_type(x509.IPAddress)]
        found = address in names.get_values_for_type(x509.IPAddress)
    except ValueError:
        known = names.get_values_for_type(x509.DNSName)
        found = _plain(host) in map(_plain, known)
    if not found:
        raise CertificateRefused(
            _Codes.BadCertificateHostNameInvalid,
            f"the certificate {name_of(certificate)} does not name the host {host}"
            f"{_but(known)}; reach the server by a name of its certificate, or set "
            f"{CHECK_HOST_NAME} = false",
        )


def application_uris(certificate: x509.Certificate) -> list[str]:
    """Return the URIs in a certificate's SubjectAlternativeName."""
    try:
        names = extension(certificate, x509.SubjectAlternativeName)
    except UNREADABLE:
        return []
    return [] if names is None else names.get_values_for_type(x509.UniformResourceIdentifier)


def _plain(host: str) -> str:
    return host.lower().rstrip(".")


def _but(known: list[str]) -> str:
    return f" but {escaped(', '.join(known[:5]))}" if known else ""
