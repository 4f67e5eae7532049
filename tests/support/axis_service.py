"""``valvemap serve`` in a process that a test kills; its operator has the password of `served`.

``python -m support.axis_service FILE.toml``
"""

import asyncio
import dataclasses
import sys
from pathlib import Path

from benchmarks.live_speed import open_settings
from guarded_opcua import Limits, Role
from guarded_opcua.security.users import UserStore
from support.served import PASSWORD
from valvemap.app.serve import serve
from valvemap.app.signals import stop_on_signal
from valvemap.config.loading import load_config


async def main() -> None:
    config, stop, users = load_config(Path(sys.argv[1])), asyncio.Event(), UserStore()
    users.add("operator", Role.OPERATOR, PASSWORD)
    with stop_on_signal(stop):
        await serve(config, stop, dataclasses.replace(open_settings(config, Limits()), users=users))


if __name__ == "__main__":
    asyncio.run(main())
