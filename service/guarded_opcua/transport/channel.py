"""Secure channels: opened with an offered policy by a trusted peer, and renewed in time."""

from collections.abc import Callable
from typing import Any, Protocol

from asyncua import ua
from asyncua.common.connection import SecureConnection, TransportLimits
from asyncua.common.utils import ServiceError
from asyncua.crypto.security_policies import SecurityPolicyNone
from typing_extensions import override

from guarded_opcua.clock import Clock
from guarded_opcua.security.certificate_rules import CertificateRefused, Use, first_certificate
from guarded_opcua.security.identity import Refused
from guarded_opcua.security.peer_certificates import PeerTrust

_Codes = ua.StatusCodes
_SHORTEST_LIFETIME_MS, _LONGEST_LIFETIME_MS = 10_000, 3_600_000
_MAX_ASYMMETRIC_BLOCKS = 8  # each costs an RSA decryption before the peer is authenticated
_NONE = ua.MessageSecurityMode.None_


class ChannelIds(Protocol):
    """Allocates channel numbers."""

    def get_new_channel_id(self) -> int:
        """Return the number of a new channel."""


class Channel(SecureConnection):
    """The server side of the secure channel of one connection."""

    def __init__(
        self,
        limits: TransportLimits,
        policies: list[Any],
        trust: PeerTrust,
        refused: Refused,
        clock: Clock,
    ) -> None:
        super().__init__(SecurityPolicyNone(), limits)
        self.limits = limits
        self.discovery_only = False
        self._trust = trust
        self._refused = refused
        self._clock = clock
        self._expires = 0.0
        self._shown = b""  # the peer's certificate, optionally followed by those of its issuers
        self.set_policy_factories(policies)

    @property
    def peer_certificate(self) -> bytes | None:
        """Certificate of the peer (DER), None without security."""
        return None if self.is_plain else self.security_policy.peer_certificate

    @property
    def is_plain(self) -> bool:
        """Whether the channel has no security."""
        return bool(self.security_policy.Mode == _NONE)

    @property
    def expired(self) -> bool:
        """Whether the channel was not renewed in time."""
        return self.is_open() and self._clock.monotonic() > self._expires

    def check_open_frame(self, shown: ua.AsymmetricAlgorithmHeader, encrypted: int) -> None:
        """Check an OpenSecureChannel before its decryption, by its header and its size in bytes."""
        if self.is_open() and shown.SecurityPolicyURI != self.security_policy.URI:
            raise ServiceError(_Codes.BadSecurityPolicyRejected)
        if self.is_open() and (shown.SenderCertificate or b"") != self._shown:
            raise ServiceError(_Codes.BadSecurityChecksFailed)
        if not str(shown.SecurityPolicyURI).endswith("#None") and encrypted > (
            _MAX_ASYMMETRIC_BLOCKS * 256
        ):
            raise ServiceError(_Codes.BadTcpMessageTooLarge)

    @override
    def select_policy(
        self, uri: str, peer_certificate: bytes | None, mode: ua.MessageSecurityMode | None = None
    ) -> None:
        offered = any(policy.matches(uri, mode) for policy in self._policies)
        if offered and not uri.endswith("#None"):
            self._shown = peer_certificate or b""
            self._check(self._trust.check)
        if offered:
            super().select_policy(uri, peer_certificate, mode)
        elif uri.endswith("#None") and mode in (None, _NONE):
            self.discovery_only = True
        else:
            raise ServiceError(_Codes.BadSecurityPolicyRejected)

    @override
    def open(
        self, params: ua.OpenSecureChannelParameters, server: ChannelIds
    ) -> ua.OpenSecureChannelResult:
        renews = params.RequestType == ua.SecurityTokenRequestType.Renew
        if renews != self.is_open():
            raise ServiceError(_Codes.BadRequestTypeInvalid)
        if params.SecurityMode != self.security_policy.Mode:
            raise ServiceError(_Codes.BadSecurityModeRejected)
        if renews and not self.is_plain:
            self._check(self._trust.check)
        if not self.is_plain and len(params.ClientNonce or b"") != (
            self.security_policy.secure_channel_nonce_length
        ):
            raise ServiceError(_Codes.BadNonceInvalid)
        wish = params.RequestedLifetime or _LONGEST_LIFETIME_MS
        params.RequestedLifetime = min(max(wish, _SHORTEST_LIFETIME_MS), _LONGEST_LIFETIME_MS)
        result = super().open(params, server)
        self._expires = self._clock.monotonic() + 1.25e-3 * params.RequestedLifetime
        return result

    def check_again(self) -> None:
        """Check that the peer is still trusted, using the folders as last read.

        Raises
        ------
        ServiceError
            with the reason's code; the refusal is audited.
        """
        if self.is_open() and not self.is_plain:
            self._check(self._trust.check_again)

    def _check(self, check: Callable[[bytes, Use], object]) -> None:
        try:
            check(self._shown, Use.CLIENT)
        except CertificateRefused as refused:
            self._refused(first_certificate(self._shown), refused.code, str(refused))
            raise ServiceError(refused.code) from refused
