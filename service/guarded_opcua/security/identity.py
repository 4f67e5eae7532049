"""User identity tokens, verified against the users of the server (Part 4, 7.41)."""

import hmac
from collections.abc import Callable
from dataclasses import dataclass, field

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto import uacrypto
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric import rsa

from guarded_opcua.security.accounts import Role
from guarded_opcua.security.certificate_rules import (
    CertificateRefused,
    Use,
    check_own_rules,
    first_certificate,
    parse,
)
from guarded_opcua.security.login_queue import LoginQueue
from guarded_opcua.security.peer_certificates import PeerTrust
from guarded_opcua.security.users import UserStore

_Codes = ua.StatusCodes
_MAX_PASSWORD_BYTES = 4_096

Refused = Callable[[bytes, int, str], None]  # certificate (DER), status code, sentence

ANONYMOUS = "anonymous"
USERNAME = "username"
CERTIFICATE = "certificate"
_DECRYPT = {
    "http://www.w3.org/2001/04/xmlenc#rsa-oaep": uacrypto.decrypt_rsa_oaep,
    "http://opcfoundation.org/UA/security/rsa-oaep-sha2-256": uacrypto.decrypt_rsa_oaep_sha256,
}
_VERIFY = {
    "http://www.w3.org/2001/04/xmldsig-more#rsa-sha256": uacrypto.verify_sha256,
    "http://opcfoundation.org/UA/security/rsa-pss-sha2-256": uacrypto.verify_pss_sha256,
}


@dataclass(frozen=True)
class Principal:
    """An authenticated user and its role."""

    name: str
    role: Role
    certificate: bytes = field(default=b"", compare=False, repr=False)  # DER, if used

    def __str__(self) -> str:
        return f"{self.name} ({self.role.name.lower()})"


@dataclass(frozen=True)
class Challenge:
    """The server's certificate (DER), key and last nonce, to which a token must be bound."""

    certificate: bytes
    key: rsa.RSAPrivateKey
    nonce: bytes


async def identify(
    token: object,
    signature: ua.SignatureData,
    challenge: Challenge,
    users: UserStore,
    origin: str,
    logins: LoginQueue,
    trust: PeerTrust,
    refused: Refused,
    *,
    anonymous_allowed: bool,
) -> Principal:
    """Authenticate a user by an identity token.

    ``trust`` checks user certificates; ``refused`` is called with the reason if one is refused.

    Raises
    ------
    ServiceError
        BadIdentityTokenInvalid for a malformed token, BadIdentityTokenRejected for a token that is
        not accepted, including a refused user certificate, BadUserAccessDenied for a wrong
        password, an unknown certificate or a locked user, BadUserSignatureInvalid.
    """
    if isinstance(token, ua.AnonymousIdentityToken) or _is_null(token):
        if not anonymous_allowed:
            raise ServiceError(_Codes.BadIdentityTokenRejected)
        return Principal(ANONYMOUS, Role.OBSERVER)
    if isinstance(token, ua.UserNameIdentityToken):
        name, password = token.UserName or "", _password(token, challenge)
        role = await logins.authenticate(name, password, origin)
        if role is None:
            raise ServiceError(_Codes.BadUserAccessDenied)
        return Principal(name, role)
    if isinstance(token, ua.X509IdentityToken):
        return _by_certificate(token, signature, challenge, users, trust, refused)
    raise ServiceError(_Codes.BadIdentityTokenInvalid)


def still_accepted(
    principal: Principal, users: UserStore, trust: PeerTrust, refused: Refused
) -> bool:
    """Return whether a logged-in user would still be accepted; checked periodically.

    It uses the folders of ``trust`` as last read.
    """
    account = users.accounts.get(principal.name)
    if account is None and principal.name == ANONYMOUS:
        return True
    if account is None or account.role != principal.role:
        return False
    if not principal.certificate:
        return bool(account.password_hash)
    try:
        trust.check_again(principal.certificate, Use.USER, account.anchors)
    except CertificateRefused as reason:
        refused(first_certificate(principal.certificate), reason.code, str(reason))
        return False
    return True


def _is_null(token: object) -> bool:
    return token is None or (isinstance(token, ua.ExtensionObject) and token.TypeId.is_null())


def _password(token: ua.UserNameIdentityToken, challenge: Challenge) -> str:
    """Return the decrypted password; a password in plain text is never accepted."""
    decrypt = _DECRYPT.get(token.EncryptionAlgorithm or "")
    secret = token.Password or b""
    if decrypt is None or not secret or len(secret) > 4 * _MAX_PASSWORD_BYTES:
        raise ServiceError(_Codes.BadIdentityTokenInvalid)
    size = challenge.key.key_size // 8
    blocks = [secret[at : at + size] for at in range(0, len(secret), size)]
    if len(blocks) > _MAX_PASSWORD_BYTES // size:
        raise ServiceError(_Codes.BadIdentityTokenInvalid)
    try:
        plain = b"".join(decrypt(challenge.key, block) for block in blocks)
    except ValueError as error:
        raise ServiceError(_Codes.BadIdentityTokenInvalid) from error
    length = int.from_bytes(plain[:4], "little")
    body = plain[4 : 4 + length]
    nonce = body[len(body) - len(challenge.nonce) :]
    if len(body) != length or not hmac.compare_digest(nonce, challenge.nonce):
        raise ServiceError(_Codes.BadIdentityTokenInvalid)
    return body[: length - len(challenge.nonce)].decode("utf-8", "replace")


def _by_certificate(
    token: ua.X509IdentityToken,
    signature: ua.SignatureData,
    challenge: Challenge,
    users: UserStore,
    trust: PeerTrust,
    refused: Refused,
) -> Principal:
    verify, shown = _VERIFY.get(signature.Algorithm or ""), token.CertificateData or b""
    if verify is None or not signature.Signature or not shown:
        raise ServiceError(_Codes.BadIdentityTokenInvalid)
    try:
        certificate, _ = parse(shown)
        check_own_rules(certificate, Use.USER)
        account = users.by_certificate(certificate)
        if account is None:
            raise ServiceError(_Codes.BadUserAccessDenied)
        verify(certificate, challenge.certificate + challenge.nonce, signature.Signature)
        trust.check(shown, Use.USER, anchors=account.anchors)
    except CertificateRefused as reason:
        refused(first_certificate(shown), reason.code, str(reason))
        raise ServiceError(_Codes.BadIdentityTokenRejected) from reason
    except (InvalidSignature, uacrypto.InvalidSignature, ValueError) as error:
        raise ServiceError(_Codes.BadUserSignatureInvalid) from error
    return Principal(account.name, account.role, shown)
