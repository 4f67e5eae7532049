"""What signals do to a running service."""

import asyncio
import os
import signal

import pytest

from valvemap.app.signals import stop_on_signal


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="there are no hang-ups here")
async def test_a_hang_up_ends_nothing_and_a_termination_does():
    stop = asyncio.Event()
    with stop_on_signal(stop):
        os.kill(os.getpid(), signal.SIGHUP)
        await asyncio.sleep(0)
        assert not stop.is_set()
        os.kill(os.getpid(), signal.SIGTERM)
        async with asyncio.timeout(5):
            await stop.wait()
