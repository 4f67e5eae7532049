"""Who logs in: user identity tokens, checked against the users of the server (Part 4, 7.41)."""

import hmac
from dataclasses import dataclass

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto import uacrypto
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric import rsa

from service.hardened.security.login_queue import LoginQueue
from service.hardened.security.users import Role, UserStore

_Codes = ua.StatusCodes
_MAX_PASSWORD_BYTES = 4_096

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
    """Who acts, and in which role."""

    name: str
    role: Role

    def __str__(self) -> str:
        return f"{self.name} ({self.role.name.lower()})"


@dataclass(frozen=True)
class Challenge:
    """What a token must be bound to: our certificate (DER), key and last nonce."""

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
    *,
    anonymous_allowed: bool,
) -> Principal:
    """Find out who logs in.

    Raises
    ------
    ServiceError
        BadIdentityTokenInvalid for what cannot be read, BadIdentityTokenRejected for what is not
        accepted here, BadUserAccessDenied for a wrong password or a locked user.
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
        return _by_certificate(token, signature, challenge, users)
    raise ServiceError(_Codes.BadIdentityTokenInvalid)


def _is_null(token: object) -> bool:
    return token is None or (isinstance(token, ua.ExtensionObject) and token.TypeId.is_null())


def _password(token: ua.UserNameIdentityToken, challenge: Challenge) -> str:
    """Decrypt it; a password in plain text is never taken."""
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
) -> Principal:
    verify = _VERIFY.get(signature.Algorithm or "")
    if verify is None or not signature.Signature or not token.CertificateData:
        raise ServiceError(_Codes.BadIdentityTokenInvalid)
    found = users.certificate_role(token.CertificateData)
    if found is None:
        raise ServiceError(_Codes.BadUserAccessDenied)
    try:
        certificate = uacrypto.x509_from_der(token.CertificateData)
        verify(certificate, challenge.certificate + challenge.nonce, signature.Signature)
    except (InvalidSignature, uacrypto.InvalidSignature, ValueError) as error:
        raise ServiceError(_Codes.BadUserSignatureInvalid) from error
    return Principal(*found)
