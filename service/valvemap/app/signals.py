"""Stops a command on signals or at the end of standard input."""

import asyncio
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from types import FrameType

import structlog

log = structlog.get_logger(__name__)


@contextmanager
def stop_on_signal(
    stop: asyncio.Event, on_hang_up: Callable[[], None] | None = None
) -> Iterator[None]:
    """Set ``stop`` on Ctrl-C or a termination signal, on every platform; survive SIGHUP.

    ``on_hang_up`` is called in the loop on SIGHUP; None: the signal is logged.
    """
    loop = asyncio.get_running_loop()

    def on_hang(_number: int, _frame: FrameType | None) -> None:
        loop.call_soon_threadsafe(on_hang_up or partial(log.info, "hang-up signal ignored"))

    def on_signal(_number: int, _frame: FrameType | None) -> None:
        loop.call_soon_threadsafe(stop.set)

    numbers = [signal.SIGINT, signal.SIGTERM]
    with suppress(AttributeError):
        numbers.append(signal.SIGBREAK)  # type: ignore[attr-defined]
    before = {number: signal.signal(number, on_signal) for number in numbers}
    with suppress(AttributeError):
        before[signal.SIGHUP] = signal.signal(signal.SIGHUP, on_hang)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def stop_with_parent(stop: asyncio.Event) -> None:
    """Set ``stop`` at the end of standard input: the parent closed it or terminated."""
    loop = asyncio.get_running_loop()

    def wait() -> None:
        sys.stdin.read()
        loop.call_soon_threadsafe(stop.set)

    threading.Thread(target=wait, daemon=True).start()
