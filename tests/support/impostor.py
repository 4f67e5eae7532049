"""A server that shows a certificate and does nothing else: whom does a client believe?"""

import asyncio
import contextlib
import struct

from asyncua import ua
from asyncua.common.connection import SecureConnection, TransportLimits
from asyncua.common.utils import Buffer
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256, SecurityPolicyNone
from asyncua.ua import ua_binary

from support.certificates import URI


class Impostor:
    """Answers GetEndpoints without security, and hangs up on every secure channel.

    Attributes
    ----------
    shown
        The certificate (DER), perhaps with a chain.
    believed
        So many clients went on to open a secure channel.
    """

    def __init__(self):
        self.shown = b""
        self.believed = 0
        self.url = ""

    @contextlib.asynccontextmanager
    async def listening(self, host="127.0.0.1"):
        server = await asyncio.start_server(self._serve, host, 0)
        self.url = f"opc.tcp://{host}:{server.sockets[0].getsockname()[1]}/impostor/"
        try:
            yield self
        finally:
            server.close()
            await server.wait_closed()

    def get_new_channel_id(self):
        return 1

    async def _serve(self, reader, writer):
        channel = SecureConnection(SecurityPolicyNone(), TransportLimits())
        try:
            while await self._answer(channel, reader, writer):
                pass
        except (asyncio.IncompleteReadError, ConnectionError):
            pass
        finally:
            writer.close()

    async def _answer(self, channel, reader, writer):
        head = await reader.readexactly(8)
        body = Buffer(head + await reader.readexactly(struct.unpack("<I", head[4:])[0] - 8))
        header = ua_binary.header_from_binary(body)
        if header.MessageType == ua.MessageType.Hello:
            answer = ua.Acknowledge(0, 65_536, 65_536, 0, 0)
            writer.write(ua_binary.uatcp_to_binary(ua.MessageType.Acknowledge, answer))
            return True
        if header.MessageType == ua.MessageType.SecureOpen:
            asked = ua_binary.struct_from_binary(ua.AsymmetricAlgorithmHeader, body.copy())
            if asked.SecurityPolicyURI != SecurityPolicyNone.URI:
                self.believed += 1
                return False
        message = channel.receive_from_header_and_body(header, body)
        content, number = message.body(), message.SequenceHeader().RequestId
        if header.MessageType == ua.MessageType.SecureOpen:
            request = ua_binary.struct_from_binary(ua.OpenSecureChannelRequest, content)
            response = ua.OpenSecureChannelResponse()
            response.Parameters = channel.open(request.Parameters, self)
        else:
            kind = ua_binary.nodeid_from_binary(content)
            if kind.Identifier != ua.ObjectIds.GetEndpointsRequest_Encoding_DefaultBinary:
                return False
            request = ua_binary.struct_from_binary(ua.RequestHeader, content)
            response = ua.GetEndpointsResponse(Endpoints=[self._endpoint()])
            response.ResponseHeader.RequestHandle = request.RequestHandle
        data = ua_binary.struct_to_binary(response)
        writer.write(channel.message_to_binary(data, header.MessageType, number))
        return True

    def _endpoint(self):
        return ua.EndpointDescription(
            EndpointUrl=self.url,
            Server=ua.ApplicationDescription(ApplicationUri=URI),
            ServerCertificate=self.shown,
            SecurityMode=ua.MessageSecurityMode.SignAndEncrypt,
            SecurityPolicyUri=SecurityPolicyBasic256Sha256.URI,
        )
