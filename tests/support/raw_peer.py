"""A peer that speaks OPC UA frame by frame and may break every rule (SecurityPolicy None)."""

import asyncio
import struct

from asyncua import ua
from asyncua.common.connection import SecureConnection, TransportLimits
from asyncua.common.utils import Buffer
from asyncua.crypto.security_policies import SecurityPolicyNone
from asyncua.ua import ua_binary


class Closed(Exception):  # noqa: N818 - an answer
    """The server closed the connection."""


class RawPeer:
    """One TCP connection."""

    def __init__(self, reader, writer):
        self.reader, self.writer = reader, writer
        self.channel = SecureConnection(SecurityPolicyNone(), TransportLimits())
        self.token = ua.NodeId()
        self.number = 0

    @classmethod
    async def connect(cls, url, source=None):
        """Connect, from another address of this machine if ``source`` names one."""
        host, port = url.removeprefix("opc.tcp://").split("/")[0].rsplit(":", 1)
        local = None if source is None else (source, 0)
        return cls(*await asyncio.open_connection(host, int(port), local_addr=local))

    async def hello(self, **changes):
        values = {
            "ReceiveBufferSize": 65_536,
            "SendBufferSize": 65_536,
            "MaxMessageSize": 0,
            "MaxChunkCount": 0,
            "EndpointUrl": "opc.tcp://localhost/",
        }
        hello = ua.Hello(0, **{**values, **changes})
        self.writer.write(ua_binary.uatcp_to_binary(ua.MessageType.Hello, hello))
        return await self.receive()

    async def open(self):
        await self.hello()
        request = ua.OpenSecureChannelRequest()
        request.Parameters.RequestedLifetime = 60_000
        request.Parameters.SecurityMode = ua.MessageSecurityMode.None_
        data = ua_binary.struct_to_binary(request)
        self.writer.write(self.channel.message_to_binary(data, ua.MessageType.SecureOpen, 1))
        message = await self.receive()
        response = ua_binary.struct_from_binary(ua.OpenSecureChannelResponse, message.body())
        self.channel.set_channel(response.Parameters, ua.SecurityTokenRequestType.Issue, None)
        self.number = 1

    async def create_session(self, application_uri=""):
        request = ua.CreateSessionRequest()
        request.Parameters.ClientDescription.ApplicationUri = application_uri
        request.Parameters.SessionName = "raw"
        request.Parameters.RequestedSessionTimeout = 60_000
        response = await self.call(request, ua.CreateSessionResponse)
        self.token = response.Parameters.AuthenticationToken
        return response.Parameters

    async def activate(self, token=None, audit_entry=""):
        request = ua.ActivateSessionRequest()
        request.RequestHeader.AuditEntryId = audit_entry
        request.Parameters.UserIdentityToken = token or ua.AnonymousIdentityToken("anonymous")
        return await self.call(request, ua.ActivateSessionResponse)

    async def log_in(self):
        await self.open()
        await self.create_session()
        await self.activate()
        return self

    def send(self, request, token=None):
        request.RequestHeader.AuthenticationToken = self.token if token is None else token
        request.RequestHeader.RequestHandle = self.number
        self.send_body(ua_binary.struct_to_binary(request))

    def send_body(self, body):
        self.number += 1
        data = self.channel.message_to_binary(body, ua.MessageType.SecureMessage, self.number)
        self.writer.write(data)

    async def call(self, request, response_type, token=None):
        self.send(request, token)
        return await self.answer(response_type)

    async def answer(self, response_type):
        """Return the next response; a fault is raised as its status code."""
        message = await self.receive()
        body = message.body()
        kind = ua_binary.nodeid_from_binary(body.copy())
        if kind.Identifier == ua.ObjectIds.ServiceFault_Encoding_DefaultBinary:
            fault = ua_binary.struct_from_binary(ua.ServiceFault, body)
            raise ua.UaStatusCodeError(fault.ResponseHeader.ServiceResult.value)
        return ua_binary.struct_from_binary(response_type, body)

    async def receive(self, patience=5.0):
        """Return the next message; an error message is raised as its status code."""
        parts = None
        while parts is None:
            async with asyncio.timeout(patience):
                try:
                    head = await self.reader.readexactly(8)
                    size = struct.unpack("<I", head[4:])[0]
                    rest = await self.reader.readexactly(size - 8)
                except (asyncio.IncompleteReadError, ConnectionError) as error:
                    raise Closed from error
            body = Buffer(head + rest)
            header = ua_binary.header_from_binary(body)
            parts = self.channel.receive_from_header_and_body(header, body)
        if isinstance(parts, ua.ErrorMessage):
            raise ua.UaStatusCodeError(parts.Error.value)
        return parts

    async def is_closed(self, patience=5.0):
        """Wait for the end of the connection."""
        try:
            async with asyncio.timeout(patience):
                while await self.reader.read(65_536):
                    pass
        except TimeoutError:
            return False
        except ConnectionError:
            pass
        return True

    def close(self):
        self.writer.close()
