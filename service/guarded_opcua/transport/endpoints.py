"""Offered security policies, user tokens and endpoint descriptions (Part 4, 7.14)."""

from typing import Any

from asyncua import ua
from asyncua.crypto import security_policies
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import rsa

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
