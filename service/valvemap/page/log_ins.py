"""Log-ins: each has its own connection to the service, authenticated as that user."""

import asyncio
import hashlib
import secrets
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field

from guarded_opcua.admission import Admission, address_of
from guarded_opcua.security.lock_out import Failures
from valvemap.clock import Clock
from valvemap.errors import CommandRejected, SourceRejected, ValvemapError
from valvemap.page.ports import Client
from valvemap.page.rates import Buckets
from valvemap.page.settings import PageSettings
from valvemap.page.turns import Turns

_MOST_NAMES = 1_000  # users; capacity of the record of wrong passwords, as in the service
_MOST_KNOWN = 1_000  # pairs of user and address with an earlier log-in
_FROM_ANYWHERE = 10  # factor on `wrong_passwords`, above which a user is locked for new addresses
_LONGEST_NAME = 64  # characters; longest user name the service accepts
_TOO_MANY = "too many tries: wait some minutes"

Clients = Callable[[str, str, str], tuple[Client, Client | None]]
"""Make clients of the service and of a demo's rig from user, password and browser address."""


@dataclass
class LogIn:
    """A user's connections; ``used`` is the time of the last use, s.

    ``connections`` counts how often they were made again, after the service was away.
    """

    user: str
    service: Client
    rig: Client | None
    used: float
    connections: int = 0
    connecting: asyncio.Lock = field(default_factory=asyncio.Lock)

    async def reconnect(self, lost: int) -> None:
        """Connect again as the same user, after ``connections`` was ``lost``: once for all callers.

        Raises
        ------
        SourceLost, SourceRejected
        """
        async with self.connecting:
            if self.connections != lost:
                return
            for client in (self.service, self.rig):
                if client is not None:
                    await client.connect()
            self.connections += 1


class LogIns:
    """All log-ins, by a secret that is stored in the browser's cookie only.

    Wrong passwords lock a user for the address they came from, as at the OPC UA server. Ten times
    as many from all addresses lock the user for every address without an earlier log-in.

    Parameters
    ----------
    clients
        Makes a user's clients.
    settings
        Limits, rates and timeouts.
    clock
        Time source of the idle timeout.
    """

    def __init__(self, clients: Clients, settings: PageSettings, clock: Clock) -> None:
        self._clients = clients
        self._settings = settings
        self._clock = clock
        self._tries = Buckets(settings.log_ins_per_s, settings.log_in_burst, clock)
        self._wrong = Failures(_MOST_NAMES, settings.wrong_pause_s)
        self._known: OrderedDict[tuple[str, str], None] = OrderedDict()  # users' known addresses
        self._turns = Turns()
        self._of: dict[str, LogIn] = {}
        self._ended: list[LogIn] = []  # log-ins to close
        self._open: Admission[str] = Admission(
            clock,
            settings.log_ins,
            settings.log_ins_of_user,
            settings.log_ins,
            lambda digest: self._of[digest].used,
            lambda _newcomer: (),
            lambda digest: self._ended.append(self._of.pop(digest)),
        )
        self.failed = self.refused = 0

    def __len__(self) -> int:
        return len(self._of)

    async def log_in(self, user: str, password: str, host: str) -> str:
        """Log in from a host; return the secret for the cookie.

        Raises
        ------
        ValvemapError
            with a message for the user: wrong password, too many tries, or the service's refusal.
        """
        try:
            return await self._log_in(user, password, address_of(host))
        except CommandRejected:
            self.refused += 1
            raise

    async def _log_in(self, user: str, password: str, address: str) -> str:
        if len(user) > _LONGEST_NAME:
            raise CommandRejected(f"a user has at most {_LONGEST_NAME} characters")
        is_known = (user, address) in self._known
        self._check_lock(user, address)
        if not self._tries.take(f"{user} at {address}" if is_known else address):
            raise CommandRejected(_TOO_MANY)
        async with self._turns.turn(address, is_known=is_known):
            self._check_lock(user, address)  # tries of the address may have failed while waiting
            service, rig = await self._connected(user, password, address)
        self._wrong.forget(user, address)
        self._remember(user, address)
        secret = secrets.token_urlsafe(32)
        digest = _digest(secret)
        self._of[digest] = LogIn(user, service, rig, self._clock.monotonic())
        is_admitted = self._open.admit(digest, user)
        if not is_admitted:
            self._end(digest)
        await self._close_ended()
        if not is_admitted:
            raise CommandRejected("this user logs in too often: try again in some seconds")
        return secret

    async def _connected(
        self, user: str, password: str, address: str
    ) -> tuple[Client, Client | None]:
        service, rig = self._clients(user, password, address)
        try:
            await service.connect()
            if rig is not None:
                await rig.connect()
        except ValvemapError as error:
            self.failed += 1
            if isinstance(error, SourceRejected):
                self._wrong.add(user, address, self._clock.monotonic())
            await _close(service, rig)
            raise
        return service, rig

    def _check_lock(self, user: str, address: str) -> None:
        now, allowed = self._clock.monotonic(), self._settings.wrong_passwords
        of_address = self._wrong.of_origin(user, address, now) >= allowed
        of_name = self._wrong.of_name(user, now) >= _FROM_ANYWHERE * allowed
        if of_address or (of_name and (user, address) not in self._known):
            raise CommandRejected(_TOO_MANY)

    def _remember(self, user: str, address: str) -> None:
        self._known[user, address] = None
        self._known.move_to_end((user, address))
        if len(self._known) > _MOST_KNOWN:
            self._known.popitem(last=False)

    def find(self, secret: str | None) -> LogIn | None:
        """Return the log-in of a secret and restart its idle timeout."""
        found = self._of.get(_digest(secret)) if secret else None
        if found is not None:
            found.used = self._clock.monotonic()
        return found

    def holds(self, secret: str | None) -> bool:
        """Whether a secret has a log-in; does not restart its idle timeout."""
        return bool(secret) and _digest(secret or "") in self._of

    async def log_out(self, secret: str | None) -> None:
        """End a log-in, if it has not ended yet."""
        if secret and self.holds(secret):
            self._end(_digest(secret))
        await self._close_ended()

    async def forget_unused(self) -> None:
        """End log-ins whose idle timeout has passed."""
        oldest = self._clock.monotonic() - self._settings.log_in_idle_s
        for digest in [digest for digest, log_in in self._of.items() if log_in.used < oldest]:
            self._end(digest)
        await self._close_ended()

    async def close(self) -> None:
        """End all log-ins."""
        for digest in list(self._of):
            self._end(digest)
        await self._close_ended()

    def _end(self, digest: str) -> None:
        self._open.leave(digest)
        self._ended.append(self._of.pop(digest))

    async def _close_ended(self) -> None:
        ended, self._ended = self._ended, []
        await asyncio.gather(*(_close(log_in.service, log_in.rig) for log_in in ended))


async def _close(service: Client, rig: Client | None) -> None:
    for client in (service, rig):
        if client is not None:
            with suppress(ValvemapError, OSError):
                await client.close()


def _digest(secret: str) -> str:
    """Hash a secret, so that comparing keys leaks nothing by timing."""
    return hashlib.sha256(secret.encode()).hexdigest()
