"""`valvemap mqtt` ends on SIGTERM, also where a task has lost its cancellation."""

import asyncio
from contextlib import suppress

from valvemap.app import mqtt


class Deaf:
    """Continues after its first cancellation, as `wait_for` does if its answer came first."""

    async def run(self):
        with suppress(asyncio.CancelledError):
            await asyncio.sleep(60.0)
        await asyncio.sleep(60.0)


class Quiet:
    async def run(self):
        await asyncio.sleep(60.0)


def test_a_task_that_lost_its_cancellation_is_cancelled_again(monkeypatch):
    monkeypatch.setattr(mqtt, "_CANCEL_AGAIN_S", 0.05)

    async def ended():
        stop = asyncio.Event()
        stop.set()
        async with asyncio.timeout(5.0):
            await mqtt._run_until_stopped(Deaf(), Quiet(), stop)

    asyncio.run(ended())
