"""The server's certificate: found, checked against the trust store, used for the channel's keys."""

import logging
from dataclasses import dataclass
from urllib.parse import urlsplit

from asyncua import Client, ua
from asyncua.crypto import security_policies, uacrypto
from cryptography import x509
from cryptography.hazmat.primitives import serialization

from guarded_opcua import CertificateError
from guarded_opcua.security.certificate_rules import CertificateRefused, Use, first_certificate
from guarded_opcua.security.certificates import expiry_warning, load_certificate, thumbprint
from guarded_opcua.security.own_certificate import OwnCertificate
from guarded_opcua.security.peer_certificates import (
    PeerTrust,
    application_uris,
    check_host_name,
)
from valvemap.errors import SourceRejected
from valvemap.opcua_client.source_errors import in_one_line
from valvemap.opcua_client.source_settings import Security, SourceSettings

_log = logging.getLogger(__name__)
_DER = serialization.Encoding.DER

_POLICIES: dict[Security, type[security_policies.SecurityPolicy]] = {
    Security.BASIC256_SHA256: security_policies.SecurityPolicyBasic256Sha256,
    Security.AES256_SHA256_RSA_PSS: security_policies.SecurityPolicyAes256Sha256RsaPss,
}


@dataclass(frozen=True)
class TrustedServer:
    """The certificate that the server presented, and the trust store to check it against."""

    trust: PeerTrust
    shown: bytes
    application_uri: str

    def check(self) -> x509.Certificate:
        """Check the certificate.

        Raises
        ------
        CertificateRefused
        """
        return self.trust.check(self.shown, Use.SERVER, self.application_uri)

    def check_again(self) -> x509.Certificate:
        """Check the certificate against the trust folders as last read.

        Raises
        ------
        CertificateRefused
        """
        return self.trust.check_again(self.shown, Use.SERVER)


async def secure(client: Client, settings: SourceSettings) -> TrustedServer | None:
    """Find the server's certificate, check that we trust it, set up keys.

    Returns
    -------
    TrustedServer
        None without security.

    Raises
    ------
    SourceRejected, CertificateError
    """
    if settings.security is Security.NONE:
        if settings.application_uri is not None:
            client.application_uri = settings.application_uri
        return None
    assert settings.pki is not None  # noqa: S101 - settings checked it
    assert settings.own is not None  # noqa: S101 - settings checked it
    client.application_uri = settings.application_uri or _uri_of(settings.own)
    policy = _POLICIES[settings.security]
    endpoints = await client.connect_and_get_server_endpoints()
    offered = sorted({f"{_fragment(e.SecurityPolicyUri)}/{e.SecurityMode.name}" for e in endpoints})
    for endpoint in endpoints:
        if (
            endpoint.SecurityPolicyUri == policy.URI
            and endpoint.SecurityMode == ua.MessageSecurityMode.SignAndEncrypt
            and endpoint.ServerCertificate
        ):
            break
    else:
        raise SourceRejected(
            f"{settings.url}: does not offer {settings.security}/SignAndEncrypt; "
            f"it offers {in_one_line(', '.join(offered))}"
        )
    server = TrustedServer(
        PeerTrust(settings.pki, require_crl=settings.require_crl),
        endpoint.ServerCertificate,
        endpoint.Server.ApplicationUri,
    )
    certificate = _trusted(settings, server, settings.own)
    await client.set_security(
        policy,
        certificate=settings.own.certificate,
        private_key=settings.own.key,
        server_certificate=uacrypto.CertProperties(certificate.public_bytes(_DER), "der"),
        mode=ua.MessageSecurityMode.SignAndEncrypt,
    )
    return server


def _trusted(
    settings: SourceSettings, server: TrustedServer, own: OwnCertificate
) -> x509.Certificate:
    """Return the server's certificate if it passes all checks; otherwise it is in ``rejected``."""
    try:
        certificate = server.check()
        if settings.check_host_name:
            check_host_name(certificate, urlsplit(settings.url).hostname or "")
    except CertificateRefused as refused:
        advice = ""
        if refused.code == ua.StatusCodes.BadCertificateUntrusted:
            mark = thumbprint(first_certificate(server.shown))
            advice = f": compare the thumbprint, then `valvemap trust {mark}`"
        elif refused.code == ua.StatusCodes.BadCertificateHostNameInvalid:
            advice = "; with `valvemap connect`, --trust-server does so"
        raise SourceRejected(f"{settings.url}: {refused}{advice}") from refused
    for known in (certificate, load_certificate(own.certificate)):
        if warning := expiry_warning(known):
            _log.warning("%s: %s", settings.url, warning)
    return certificate


def _uri_of(own: OwnCertificate) -> str:
    uris = application_uris(load_certificate(own.certificate))
    if not uris:
        raise CertificateError(f"{own.certificate}: names no application (URI in its SAN)")
    return uris[0]


def _fragment(uri: str | None) -> str:
    return (uri or "").rpartition("#")[2]
