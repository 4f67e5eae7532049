"""A server of another make, with units, names and stamps of its own."""

import asyncio
import threading
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from asyncua import Server, ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import User, UserRole
from cryptography.hazmat.primitives.serialization import Encoding

PSI, GALLON = 14.503773773, 3.785411784


def information(code, symbol):
    number = int.from_bytes(code.encode(), "big")
    uri = "http://www.opcfoundation.org/UA/units/un/cefact"
    return ua.EUInformation(uri, number, ua.LocalizedText(symbol), ua.LocalizedText(symbol))


PLANT = {
    "Stellwert": (information("4K", "mA"), ua.Range(4.0, 20.0)),
    "Druck vor Ventil": (information("PS", "psi"), None),
    "Druck nach Ventil": (information("PS", "psi"), None),
    "Volumenstrom": (information("G2", "gpm"), None),
    "Öltemperatur": (information("FAH", "°F"), None),
    "Drehzahl Pumpe": (None, None),
}


def scattered(k, _place, _t):
    """U (%), p1, p2 (bar), Q (l/min): a scan's values belong to one instant, none to the next."""
    rng = np.random.default_rng(k)
    U, dp = rng.uniform(5, 95), rng.uniform(20, 150)
    return U, dp + 5, 5.0, 0.1 * U * dp**0.5


@dataclass(frozen=True)
class Guard:
    """What a server asks of its clients: a certificate in the folder of trusted ones; a user."""

    certificate: Path
    key: Path
    uri: str
    trusted: Path
    user: str
    password: str

    async def protect(self, server):
        async def check(certificate, _application):
            known = {file.read_bytes() for file in self.trusted.glob("*.der")}
            if certificate.public_bytes(Encoding.DER) not in known:
                raise ServiceError(ua.StatusCodes.BadSecurityChecksFailed)

        await server.set_application_uri(self.uri)
        await server.load_certificate(str(self.certificate))
        await server.load_private_key(str(self.key))
        server.set_certificate_validator(check)
        server.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
        server.set_identity_tokens([ua.UserNameIdentityToken])

    def get_user(self, iserver, username=None, password=None, certificate=None):
        right = (username, password) == (self.user, self.password)
        return User(role=UserRole.User, name=username) if right else None


class Foreign(threading.Thread):
    """A server of another make in a thread of its own: 20 Hz, one signal 3 ms after the other.

    ``move(k, place, t)`` says U, p1, p2 and Q of the k-th scan of a valve at t s. Without a `Guard`
    it asks nothing of its clients.
    """

    def __init__(self, names, folders, move=scattered, listen="127.0.0.1:0", guard=None):
        super().__init__(daemon=True)
        self.listen, self.guard = listen, guard
        self.names, self.folders, self.move, self.url = names, folders, move, None
        self.ready, self.over = threading.Event(), threading.Event()

    def run(self):
        asyncio.run(self.serve())

    async def serve(self):
        server = Server(user_manager=self.guard)
        await server.init()
        server.set_endpoint(f"opc.tcp://{self.listen}/plc/")
        if self.guard is None:
            server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        else:
            await self.guard.protect(server)
        index = await server.register_namespace("urn:plc")
        nodes = [await self.add(server, index, folder) for folder in self.folders]
        async with server:
            port = server.bserver._server.sockets[0].getsockname()[1]
            self.url = f"opc.tcp://127.0.0.1:{port}/plc/"
            self.ready.set()
            k = 0
            while not self.over.is_set():
                await self.step(server, nodes, k := k + 1)
                await asyncio.sleep(0.05)

    async def add(self, server, index, folder):
        parent = await server.nodes.objects.add_object(index, folder)
        nodes = []
        for name, (unit, bounds) in self.names.items():
            node = await parent.add_variable(ua.NodeId(f"{folder}/{name}", index), name, 0.0)
            if unit is not None:
                await node.add_property(0, "EngineeringUnits", unit)
            if bounds is not None:
                await node.add_property(0, "EURange", bounds)
            nodes.append(node)
        return nodes

    async def step(self, server, valves, k):
        now = datetime.now(UTC)
        for valve, nodes in enumerate(valves):
            for place, node in enumerate(nodes):
                late = timedelta(milliseconds=3 * place)
                t = k * 0.05 + 0.003 * place
                U, p1, p2, Q = self.move(k, valve, t)
                values = 4 + 0.16 * U, p1 * PSI, p2 * PSI, Q / GALLON, 104.0, 1500.0
                await server.write_attribute_value(
                    node.nodeid,
                    ua.DataValue(ua.Variant(float(values[place])), SourceTimestamp=now + late),
                )
