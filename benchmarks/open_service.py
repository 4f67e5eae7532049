"""``valvemap serve`` with an endpoint for anonymous clients: ``-m benchmarks.open_service``.

The argument is a configuration file. Whatever holds the loop for long is named on standard output,
with the processor time that it took: a busy machine does not change that.
"""

import asyncio
import sys
import time
from asyncio import Handle
from pathlib import Path

from benchmarks.live_speed import open_settings
from guarded_opcua import Limits
from valvemap.app.serve import serve
from valvemap.app.signals import stop_on_signal
from valvemap.cli.logs import set_up_logs
from valvemap.config.loading import load_config
from valvemap.config.logs import LogConfig

NAMED_S = 0.03


def name_what_holds_the_loop() -> None:
    run = Handle._run  # noqa: SLF001 - asyncio's own debug mode looks at the clock on the wall

    def timed(handle: Handle) -> None:
        began = time.thread_time()
        run(handle)
        took = time.thread_time() - began
        if took >= NAMED_S:
            print(f"held for {took:.3f} s by {handle!r}", flush=True)

    Handle._run = timed  # type: ignore[method-assign]  # noqa: SLF001


async def serve_openly(file: Path) -> None:
    set_up_logs(LogConfig())
    config, stop = load_config(file), asyncio.Event()
    with stop_on_signal(stop):
        await serve(config, stop, open_settings(config, Limits()))


if __name__ == "__main__":
    name_what_holds_the_loop()
    asyncio.run(serve_openly(Path(sys.argv[1])))
