"""The service manager (systemd): ready, alive, stopping, as `sd_notify` messages.

A message is one datagram of ``NAME=value`` lines to the Unix socket that ``NOTIFY_SOCKET`` names
(`sd_notify(3)`). No library is needed, and a lost message never disturbs the service: the manager
then stops or restarts it by its own timeouts.
"""

import asyncio
import os
import socket
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import Final

import structlog

from valvemap.app.pulse import Pulse
from valvemap.clock import Clock

log = structlog.get_logger(__name__)

Wait = Callable[[float], Awaitable[None]]

BEATS: Final = 3  # messages per watchdog period; two may be lost; sd_watchdog_enabled(3) asks for 2
_SEPARATORS: Final = str.maketrans({"\n": " ", "\0": " "})


@dataclass(frozen=True)
class ServiceManager:
    """The service manager that started this process, if any.

    Attributes
    ----------
    address
        Address of its socket: an absolute path, or ``@name`` in the abstract namespace. None: no
        manager; messages are dropped.
    watchdog_s
        Watchdog timeout after which it restarts the service; 0: no watchdog.
    """

    address: str | None = None
    watchdog_s: float = 0.0

    @classmethod
    def of(cls, environment: Mapping[str, str], pid: int | None = None) -> "ServiceManager":
        """Create it from environment variables; ignore a watchdog set for another process."""
        address = environment.get("NOTIFY_SOCKET", "")
        if not address.startswith(("/", "@")) or not hasattr(socket, "AF_UNIX"):
            return cls()
        watched = environment.get("WATCHDOG_PID", "") in {"", str(pid or os.getpid())}
        given = environment.get("WATCHDOG_USEC", "")
        period_us = int(given) if watched and given.isascii() and given.isdigit() else 0
        return cls(address, period_us * 1e-6)

    def ready(self, status: str) -> None:
        """Notify that clients are served."""
        self._send("READY=1", f"STATUS={status}")

    def alive(self) -> None:
        """Restart the watchdog's period."""
        self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """Notify that the service stores its states and stops."""
        self._send("STOPPING=1", "STATUS=keeping states")

    def _send(self, *lines: str) -> None:
        if self.address is None:
            return
        name = "\0" + self.address[1:] if self.address[0] == "@" else self.address
        message = "\n".join(line.translate(_SEPARATORS) for line in lines).encode()
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out:
                out.settimeout(0.0)  # a manager that does not read delays nothing
                out.sendto(message, name)
        except OSError as error:
            log.warning("service manager not notified", message=lines[0], reason=error.strerror)


async def feed_watchdog(
    manager: ServiceManager, pulse: Pulse, clock: Clock, wait: Wait = asyncio.sleep
) -> None:
    """Feed the manager's watchdog while the supervisor is alive, until cancelled.

    It runs in the event loop, so a blocked loop sends nothing. A hanging supervisor is logged, and
    nothing is sent until it is alive again.
    """
    if manager.watchdog_s <= 0.0:
        return
    silent = False
    while True:
        silence_s = pulse.overdue_s(clock.monotonic(), manager.watchdog_s)
        if silence_s <= 0.0:
            manager.alive()
        elif not silent:
            log.error("supervisor silent, watchdog not fed", longer_than_allowed_by_s=silence_s)
        silent = silence_s > 0.0
        await wait(manager.watchdog_s / BEATS)
