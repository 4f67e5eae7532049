"""The endpoint: its URL, and the offered policies, user tokens, descriptions (Part 4, 7.14)."""

import ipaddress
from typing import Any
from urllib.parse import urlparse

from asyncua import ua
from asyncua.crypto import security_policies
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import rsa

from guarded_opcua.errors import ConfigurationError
from guarded_opcua.security.identity import ANONYMOUS, CERTIFICATE, USERNAME
from guarded_opcua.settings import ServerSettings

_TRANSPORT = "http://opcfoundation.org/UA-Profile/Transport/uatcp-uasc-uabinary"
_MODE = ua.MessageSecurityMode.SignAndEncrypt
_NONE = ua.MessageSecurityMode.None_
# policy and its SecurityLevel: a client selects the highest that it supports
_SECURED = (
    (security_policies.SecurityPolicyBasic256Sha256, 70),
    (security_policies.SecurityPolicyAes256Sha256RsaPss, 80),
)
_TOKEN_POLICY = security_policies.SecurityPolicyBasic256Sha256.URI


def check_endpoint(settings: ServerSettings) -> None:
    """Check the endpoint's URL, and that its security fits where it listens.

    Raises
    ------
    ConfigurationError
    """
    parsed = urlparse(settings.url)
    try:
        complete = parsed.scheme == "opc.tcp" and parsed.hostname and parsed.port is not None
    except ValueError:
        complete = False
    if not complete:
        raise ConfigurationError(
            f"{settings.url}: an endpoint like opc.tcp://127.0.0.1:4840/path/ is needed"
        )
    if settings.none_on_loopback and parsed.hostname not in ("127.0.0.1", "::1"):
        raise ConfigurationError(
            f"{settings.url}: without security a server listens on 127.0.0.1 or ::1 only"
        )
    if settings.pki is None and not settings.none_on_loopback:
        raise ConfigurationError(f"{settings.url}: a server on the network needs a PKI folder")


def endpoint_url(settings: ServerSettings, port: int | None) -> str:
    """Return the endpoint's URL; ``port`` is the one that is listened on, None before the start."""
    parsed = urlparse(settings.url)
    port = parsed.port if port is None else port
    return parsed._replace(netloc=f"{_bracketed(parsed.hostname or '')}:{port}").geturl()


def offered_policies(
    settings: ServerSettings, certificate: x509.Certificate, key: rsa.RSAPrivateKey
) -> list[Any]:
    """Return the security policies that a channel may be opened with."""
    offered = []
    if settings.pki is not None:
        offered += [(policy, _MODE) for policy, _ in _SECURED]
    if settings.none_on_loopback:
        offered.append((security_policies.SecurityPolicyNone, _NONE))
    return [
        security_policies.SecurityPolicyFactory(policy, mode, certificate, key)
        for policy, mode in offered
    ]


def offered_endpoints(
    settings: ServerSettings, url: str, certificate: bytes
) -> list[ua.EndpointDescription]:
    """Return the endpoint descriptions."""
    endpoints = []
    if settings.pki is not None:
        endpoints += [
            _endpoint(settings, url, certificate, policy.URI, _MODE, level)
            for policy, level in _SECURED
        ]
    if settings.none_on_loopback:
        none = security_policies.SecurityPolicyNone.URI
        endpoints.append(_endpoint(settings, url, certificate, none, _NONE, 0))
    return endpoints


def _endpoint(
    settings: ServerSettings,
    url: str,
    certificate: bytes,
    policy: str,
    mode: ua.MessageSecurityMode,
    level: int,
) -> ua.EndpointDescription:
    # passwords are also encrypted inside of an encrypted channel
    token_policy = _TOKEN_POLICY if mode == _NONE else policy
    tokens = [
        ua.UserTokenPolicy(
            PolicyId=USERNAME,
            TokenType=ua.UserTokenType.UserName,
            SecurityPolicyUri=token_policy,
        ),
        ua.UserTokenPolicy(
            PolicyId=CERTIFICATE,
            TokenType=ua.UserTokenType.Certificate,
            SecurityPolicyUri=token_policy,
        ),
    ]
    if settings.none_on_loopback or settings.anonymous_observer:
        anonymous = ua.UserTokenPolicy(PolicyId=ANONYMOUS, TokenType=ua.UserTokenType.Anonymous)
        tokens.insert(0, anonymous)
    return ua.EndpointDescription(
        EndpointUrl=url,
        Server=ua.ApplicationDescription(
            ApplicationUri=settings.application_uri,
            ProductUri=settings.product.uri,
            ApplicationName=ua.LocalizedText(settings.application_name),
            ApplicationType=ua.ApplicationType.Server,
            DiscoveryUrls=[url],
        ),
        ServerCertificate=certificate,
        SecurityMode=mode,
        SecurityPolicyUri=policy,
        UserIdentityTokens=tokens,
        TransportProfileUri=_TRANSPORT,
        SecurityLevel=level,
    )


def _bracketed(host: str) -> str:
    try:
        return f"[{host}]" if ipaddress.ip_address(host).version == 6 else host
    except ValueError:
        return host
