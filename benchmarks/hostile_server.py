"""A server to be attacked, ours or a plain one: ``python -m benchmarks.hostile_server ours PORT``.

Both have the same nodes and the default settings of their makers; both write to stderr what they
log. A counter goes up 20 times a second.
"""

import asyncio
import logging
import sys

from asyncua import Server, ua

from service.hardened import (
    HardenedServer,
    Role,
    ServerSettings,
    UserStore,
    add_object,
    add_variable,
)

PERIOD_S = 0.05
BIG = [0.5] * 20_000
USER, PASSWORD = "operator", "correct horse"


async def ours(port):
    users = UserStore()
    users.add(USER, Role.OPERATOR, PASSWORD)
    settings = ServerSettings(
        url=f"opc.tcp://127.0.0.1:{port}/",
        application_uri="urn:bench:hostile",
        application_name="hostile",
        namespace_uri="urn:hostile",
        users=users,
        none_on_loopback=True,
    )
    server = await HardenedServer.create(settings)
    plant = await add_object(server, None, "Plant")
    await add_variable(server, plant, "Plant.Big", BIG, dimensions=(0,))
    kind = ua.VariantType.UInt32
    counter = await add_variable(server, plant, "Plant.Counter", 0, type=kind)
    async with server:
        await count(lambda number: server.write([(counter, number, 0, server._clock.now())]))  # noqa: SLF001


async def plain(port):
    server = Server()
    await server.init()
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}/")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    index = await server.register_namespace("urn:hostile")
    plant = await server.nodes.objects.add_object(ua.NodeId("Plant", index), "Plant")
    await plant.add_variable(ua.NodeId("Plant.Big", index), "Big", BIG)
    counter = await plant.add_variable(
        ua.NodeId("Plant.Counter", index), "Counter", 0, ua.VariantType.UInt32
    )
    async with server:
        await count(lambda number: counter.write_value(number, ua.VariantType.UInt32))


async def count(write):
    print("ready", flush=True)
    loop = asyncio.get_running_loop()
    number, due = 0, loop.time()
    while True:
        number, due = number + 1, due + PERIOD_S
        outcome = write(number)
        if outcome is not None:
            await outcome
        await asyncio.sleep(max(0.0, due - loop.time()))


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO)
    asyncio.run({"ours": ours, "plain": plain}[sys.argv[1]](int(sys.argv[2])))
