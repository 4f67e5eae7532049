"""What ends a command that runs until it is told to."""

import asyncio
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType


@contextmanager
def stop_on_signal(stop: asyncio.Event) -> Iterator[None]:
    """Set ``stop`` on Ctrl-C or a termination signal, on every platform."""
    loop = asyncio.get_running_loop()

    def on_signal(_number: int, _frame: FrameType | None) -> None:
        loop.call_soon_threadsafe(stop.set)

    numbers = [signal.SIGINT, signal.SIGTERM]
    with suppress(AttributeError):
        numbers.append(signal.SIGBREAK)  # type: ignore[attr-defined]
    before = {number: signal.signal(number, on_signal) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def stop_with_parent(stop: asyncio.Event) -> None:
    """Set ``stop`` at the end of standard input: the parent has closed it, or is dead."""
    loop = asyncio.get_running_loop()

    def wait() -> None:
        sys.stdin.read()
        loop.call_soon_threadsafe(stop.set)

    threading.Thread(target=wait, daemon=True).start()
