"""o6 (Python over open62541) as a plant's server; see :mod:`support.source_interoperation`.

A program of its own: importing o6 starts a timer that ends the process after 10 minutes.
"""

import asyncio
import json
import sys
from types import ModuleType

_NAMESPACE = "urn:plant"
_SIGNALS = {
    "U": "Double",
    "p1": "Double",
    "p2": "Float",
    "Q": "Double",
    "T": "Double",
    "Sequence": "UInt32",
}
_EPOCH_TICKS = 116_444_736_000_000_000  # 1970 in units of 100 ns since 1601
_MAY_READ, _MAY_WRITE = 1, 3  # bits of AccessLevel


class Operations:
    """One method per operation."""

    def __init__(self):
        import o6

        self.o6 = o6
        self.server = None
        self.namespace = o6.ns.register(shortname="plant", uri=_NAMESPACE, scope="plant")

    async def start(self, step):
        self.server = self.o6.Server(
            port=step["port"],
            certificate=step["certificate"],
            privateKey=step["key"],
            trustList=[step["trusted"]],
            applicationUri=step["applicationUri"],
            accessControl=_access_control(self.o6, step["user"], step["password"]),
        )
        plant = ModuleType("plant")
        plant.__NAMESPACES__ = {self.namespace}
        self.server.ns.append(plant)
        await self.populate()
        self.server.start()
        await self.server.waitReady()
        return {"url": f"opc.tcp://127.0.0.1:{step['port']}/plant/"}

    async def populate(self):
        index = self.namespace.index
        valve = await self.server.addObject("V1", "i=85", nodeId=self._id("V1"), ns=index)

        async def add(name, value, *, writable=False):
            id_ = self._id(f"V1.{name}")
            await self.server.addVariable(
                name, valve, value, nodeId=id_, writable=writable, ns=index
            )

        for name, kind in _SIGNALS.items():
            await add(name, getattr(self.o6, kind)(0))
        await add("Text", "x")
        await add("Array", [self.o6.Double(1.0)])
        await add("Command", self.o6.Double(0.0), writable=True)

    async def sample(self, step):
        for (name, kind), value in zip(_SIGNALS.items(), step["values"], strict=True):
            sample = self.o6.DataValue()
            sample.value = getattr(self.o6, kind)(value)
            sample.status = self.o6.StatusCode(step["code"])
            sample.sourceTimestamp = self.o6.DateTime(step["time"] * 10_000 + _EPOCH_TICKS)
            code = await self.server.write(self._id(f"V1.{name}"), sample)
            code.check(message=name)
        return {}

    async def command(self, _):
        return {"value": float(await self.server.read(self._id("V1.Command")))}

    async def stop(self, _):
        await self.server.stop()
        return {}

    def _id(self, text):
        return self.o6.NodeId(f"ns=plant;s={text}")


def _access_control(o6, user, password):
    from o6.ns import ns0

    class AccessControl(o6.AccessControl):
        def activateSession(self, _endpoint, _certificate, _session, token):
            if not isinstance(token, ns0.datatypes.UserNameIdentityToken):
                return "anonymous"
            if (token.userName, bytes(token.password).decode()) != (user, password):
                raise o6.StatusCodeError(o6.StatusCode.BAD_USER_ACCESS_DENIED)
            return user

        def getUserAccessLevel(self, session, node):
            writable = session.context == user or "Command" not in str(node)
            return _MAY_WRITE if writable else _MAY_READ

    return AccessControl(username=True)


async def main(out):
    operations = Operations()
    while line := await asyncio.to_thread(sys.stdin.readline):
        step = json.loads(line)
        try:
            answer = {"result": await getattr(operations, step["op"])(step)}
        except operations.o6.StatusCodeError as error:
            answer = {"error": str(error), "code": int(error.code)}
        print(json.dumps(answer), file=out, flush=True)


if __name__ == "__main__":
    answers, sys.stdout = sys.stdout, sys.stderr  # o6 has something to say at its start
    asyncio.run(main(answers))
