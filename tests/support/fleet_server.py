"""``valvemap fleet serve`` without security: ``fleet_server.py FLEET.toml PORT PASSWORD``."""

import asyncio
import sys
from pathlib import Path

from guarded_opcua import Role, ServerSettings, UserStore
from valvemap.app.identities import APPLICATION_NAME, APPLICATION_URI
from valvemap.app.signals import stop_on_signal
from valvemap.cli.logs import set_up_logs
from valvemap.kafka.serve import serve
from valvemap.kafka.settings import load_fleet


async def main(file, port, password):
    """Serve until asked to end."""
    users = UserStore()
    users.add("operator", Role.OPERATOR, password)
    settings = ServerSettings(
        url=f"opc.tcp://127.0.0.1:{port}/valvemap/service/",
        application_uri=APPLICATION_URI,
        application_name=APPLICATION_NAME,
        namespace_uri=APPLICATION_URI,
        users=users,
        none_on_loopback=True,
    )
    stop = asyncio.Event()
    with stop_on_signal(stop):
        await serve(load_fleet(Path(file)), None, stop, settings)


if __name__ == "__main__":
    set_up_logs()
    asyncio.run(main(*sys.argv[1:]))
