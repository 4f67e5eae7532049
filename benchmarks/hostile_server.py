"""A server to be attacked, ours or a plain one: ``python -m benchmarks.hostile_server ours PORT``.

Both have the same nodes and the default settings of their makers; both log to
stderr. A counter goes up 10 times a second, and ours writes 200 other values each time and has ten
of its hundred alarms change.
"""

import asyncio
import gc
import logging
import sys
import time

from asyncua import Server, ua

from benchmarks.hostile_past import Alarms, Past
from guarded_opcua import (
    HardenedServer,
    Role,
    ServerSettings,
    UserStore,
    add_object,
    add_variable,
)

PERIOD_S = 0.1
SINGLES = 200
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
    singles = [await add_variable(server, plant, f"Plant.Single{i}", 0.0) for i in range(SINGLES)]

    past = Past()
    server.add_history([await add_variable(server, plant, "Plant.Past", 0.0)], past)
    server.let_emit(plant, ua.NodeId(ua.ObjectIds.Server))
    server.add_event_history([ua.NodeId(ua.ObjectIds.Server), plant], past, ["EventId", "Time"])
    alarms = Alarms(server)
    server.keep_conditions(alarms)

    def write(number):
        now = time.time_ns()
        alarms.change()
        server.write([(counter, number, 0, now)])
        server.write([(single, number + 0.5, 0, now) for single in singles])

    async with server:
        await count(write)


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
    gc.set_threshold(50_000, 20, 20)  # as the command line does
    asyncio.run({"ours": ours, "plain": plain}[sys.argv[1]](int(sys.argv[2])))
