"""Who is logged in: each log-in is a connection of its own to the service, as that user."""

import asyncio
import hashlib
import secrets
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from valvemap.clock import Clock
from valvemap.errors import CommandRejected, ValvemapError
from valvemap.page.ports import Client
from valvemap.page.rates import TokenBucket
from valvemap.page.settings import PageSettings

_MOST_NAMES = 1_000  # whose wrong passwords are remembered; at 0.2 tries a second an hour's worth

Clients = Callable[[str, str], tuple[Client, Client | None]]
"""From user and password to the clients of the service and, in a demo, of the rig."""


@dataclass
class LogIn:
    """A user's connections; ``used`` is when they last were, s."""

    user: str
    service: Client
    rig: Client | None
    used: float


class LogIns:
    """All log-ins by a secret that only the browser's cookie holds.

    Parameters
    ----------
    clients
        Makes a user's clients.
    settings
        How many, how often, how long.
    clock
        For what is not used.
    """

    def __init__(self, clients: Clients, settings: PageSettings, clock: Clock) -> None:
        self._clients = clients
        self._settings = settings
        self._clock = clock
        self._tries = TokenBucket(settings.log_ins_per_s, settings.log_in_burst, clock)
        self._of: dict[str, LogIn] = {}
        self._wrong: dict[str, tuple[int, float]] = {}  # in a row, and when the last was
        self._one_at_a_time = asyncio.Lock()
        self.failed = 0

    def __len__(self) -> int:
        return len(self._of)

    async def log_in(self, user: str, password: str) -> str:
        """Log in; return the secret for the cookie.

        Raises
        ------
        ValvemapError
            in words for the user: wrong password, too many tries, the service's refusal.
        """
        async with self._one_at_a_time:
            await self.forget_unused()
            if len(self._of) >= self._settings.log_ins:
                raise CommandRejected("too many users are logged in")
            if not self._tries.take() or self._is_paused(user):
                raise CommandRejected("too many tries: wait some minutes")
            service, rig = self._clients(user, password)
            try:
                await service.connect()
                if rig is not None:
                    await rig.connect()
            except ValvemapError:
                self.failed += 1
                self._note_wrong(user)
                await _close(service, rig)
                raise
            self._wrong.pop(user, None)
            secret = secrets.token_urlsafe(32)
            self._of[_digest(secret)] = LogIn(user, service, rig, self._clock.monotonic())
            return secret

    def _is_paused(self, user: str) -> bool:
        """Whether one more wrong password could lock the user out at the service."""
        count, last = self._wrong.get(user, (0, 0.0))
        if self._clock.monotonic() - last > self._settings.wrong_pause_s:
            self._wrong.pop(user, None)
            return False
        return count >= self._settings.wrong_passwords

    def _note_wrong(self, user: str) -> None:
        count, _ = self._wrong.pop(user, (0, 0.0))
        self._wrong[user] = (count + 1, self._clock.monotonic())
        if len(self._wrong) > _MOST_NAMES:
            del self._wrong[next(iter(self._wrong))]

    def find(self, secret: str | None) -> LogIn | None:
        """Who holds that secret."""
        found = self._of.get(_digest(secret)) if secret else None
        if found is not None:
            found.used = self._clock.monotonic()
        return found

    async def log_out(self, secret: str | None) -> None:
        """End a log-in; nothing happens if it has ended."""
        found = self._of.pop(_digest(secret), None) if secret else None
        if found is not None:
            await _close(found.service, found.rig)

    async def forget_unused(self) -> None:
        """End log-ins that nobody uses."""
        oldest = self._clock.monotonic() - self._settings.log_in_idle_s
        for digest, log_in in list(self._of.items()):
            if log_in.used < oldest:
                del self._of[digest]
                await _close(log_in.service, log_in.rig)

    async def close(self) -> None:
        """End all of them."""
        for log_in in self._of.values():
            await _close(log_in.service, log_in.rig)
        self._of.clear()


async def _close(service: Client, rig: Client | None) -> None:
    for client in (service, rig):
        if client is not None:
            with suppress(ValvemapError, OSError):
                await client.close()


def _digest(secret: str) -> str:
    """A key that gives nothing away by the time it takes to compare it."""
    return hashlib.sha256(secret.encode()).hexdigest()
