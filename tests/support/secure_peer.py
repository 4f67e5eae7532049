"""A raw peer that opens its channel with whatever certificate it likes (Basic256Sha256)."""

import secrets

from asyncua import ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from asyncua.ua import ua_binary

from support.certificates import URI
from support.raw_peer import RawPeer

_SIGN_AND_ENCRYPT = ua.MessageSecurityMode.SignAndEncrypt
_RSA_SHA256 = "http://www.w3.org/2001/04/xmldsig-more#rsa-sha256"


class SecurePeer(RawPeer):
    """One TCP connection with a certificate of one's own."""

    @classmethod
    async def opened(cls, server, identity, chain=()):
        """Open a channel to a running server, sending ``chain`` along."""
        peer = await cls.connect(server.url)
        peer.identity = identity
        peer.server_certificate = server._listener._shared.own.certificate
        policy = SecurityPolicyBasic256Sha256(
            peer.server_certificate,
            identity.certificate,
            identity.key,
            _SIGN_AND_ENCRYPT,
            host_cert_chain=[link.certificate for link in chain],
        )
        peer.channel.security_policy = policy
        try:
            await peer.hello()
            await peer.open_channel(ua.SecurityTokenRequestType.Issue)
        except BaseException:
            peer.close()
            raise
        return peer

    async def open_channel(self, kind):
        request = ua.OpenSecureChannelRequest()
        request.Parameters.RequestType = kind
        request.Parameters.RequestedLifetime = 60_000
        request.Parameters.SecurityMode = _SIGN_AND_ENCRYPT
        nonce = request.Parameters.ClientNonce = secrets.token_bytes(32)
        data = ua_binary.struct_to_binary(request)
        self.number += 1
        self.writer.write(
            self.channel.message_to_binary(data, ua.MessageType.SecureOpen, self.number)
        )
        message = await self.receive()
        response = ua_binary.struct_from_binary(ua.OpenSecureChannelResponse, message.body())
        self.channel.set_channel(response.Parameters, kind, nonce)

    async def renew(self):
        await self.open_channel(ua.SecurityTokenRequestType.Renew)
        self.channel.revolve_tokens()

    async def create(self, shown=None):
        request = ua.CreateSessionRequest()
        request.Parameters.SessionName = "secure"
        request.Parameters.RequestedSessionTimeout = 60_000
        request.Parameters.ClientCertificate = shown or self.identity.der
        request.Parameters.ClientNonce = secrets.token_bytes(32)
        request.Parameters.ClientDescription.ApplicationUri = URI
        made = (await self.call(request, ua.CreateSessionResponse)).Parameters
        self.token, self.nonce = made.AuthenticationToken, made.ServerNonce

    async def activate_as(self, user, chain=()):
        """Log in with a user's certificate."""
        token = ua.X509IdentityToken("certificate", user.der + b"".join(u.der for u in chain))
        proof = self.server_certificate + self.nonce
        sign = SecurityPolicyBasic256Sha256.sign_asymmetric
        request = ua.ActivateSessionRequest()
        request.Parameters.ClientSignature = ua.SignatureData(
            _RSA_SHA256, sign(self.identity.key, proof)
        )
        request.Parameters.UserIdentityToken = token
        request.Parameters.UserTokenSignature = ua.SignatureData(_RSA_SHA256, sign(user.key, proof))
        response = await self.call(request, ua.ActivateSessionResponse)
        self.nonce = response.Parameters.ServerNonce

    async def log_in_as(self, user, chain=()):
        await self.create()
        await self.activate_as(user, chain)

    async def read_state(self):
        """Read ServerState; proves that the session is alive."""
        request = ua.ReadRequest()
        node = ua.NodeId(ua.ObjectIds.Server_ServerStatus_State)
        request.Parameters.NodesToRead = [ua.ReadValueId(node, ua.AttributeIds.Value)]
        return (await self.call(request, ua.ReadResponse)).Results[0].Value.Value
