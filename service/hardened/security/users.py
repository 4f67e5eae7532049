"""Who may do what: roles, hashed passwords, lock-out."""

import base64
import hashlib
import hmac
import json
import os
import secrets
import sys
from collections import OrderedDict
from dataclasses import asdict, dataclass
from enum import IntEnum
from pathlib import Path
from typing import Self

from service.hardened.clock import Clock, SystemClock
from service.hardened.errors import ConfigurationError, StorageError
from service.hardened.security.lock_out import Failures

_SCRYPT_N, _SCRYPT_R, _SCRYPT_P = 2**14, 8, 1  # 16 MB and some 40 ms a guess
_SCRYPT_MEMORY = 64 * 1024 * 1024
_REMEMBERED_STRANGERS = 1_000  # names that nobody has
_REMEMBERED_ORIGINS = 100  # addresses from which a user has logged in
_DUMMY_SALT = bytes(16)


class Role(IntEnum):
    """What a user may do; a higher role may do all that a lower one may.

    >>> Role.OPERATOR >= Role.OBSERVER
    True
    """

    OBSERVER = 1
    OPERATOR = 2
    ENGINEER = 3
    SECURITY_ADMIN = 4


@dataclass(frozen=True)
class Account:
    """One user as stored: the password only as a salted scrypt hash, or a certificate.

    ``password_hash`` and ``salt`` are base64; ``thumbprint`` is the SHA-1 of the user
    certificate in hex, as OPC UA counts it. Either may be empty.
    """

    name: str
    role: Role
    salt: str = ""
    password_hash: str = ""
    thumbprint: str = ""
    n: int = _SCRYPT_N
    r: int = _SCRYPT_R
    p: int = _SCRYPT_P


class UserStore:
    """The users of a server.

    After ``allowed_failures`` wrong passwords for one name from one peer, that pair is locked
    for ``lock_seconds``; ten times as many from anywhere lock the name for everybody but those
    addresses from which the user has logged in before, so that many peers guess no faster. While
    locked, the right password is refused too.

    >>> store = UserStore()
    >>> store.add("anna", Role.ENGINEER, "correct horse")
    >>> store.authenticate("anna", "correct horse")
    <Role.ENGINEER: 3>
    >>> store.authenticate("anna", "battery staple") is None
    True
    """

    def __init__(
        self,
        *,
        allowed_failures: int = 5,
        lock_seconds: float = 300.0,
        clock: Clock | None = None,
    ) -> None:
        self._accounts: dict[str, Account] = {}
        self._failures_of_users = Failures(sys.maxsize, lock_seconds)
        self._failures_of_strangers = Failures(_REMEMBERED_STRANGERS, lock_seconds)
        self._origins: dict[str, OrderedDict[str, None]] = {}  # where each user has logged in
        self._allowed_failures = allowed_failures
        self._clock = clock or SystemClock()

    @classmethod
    def one_time(cls, name: str, role: Role) -> tuple[Self, str]:
        """Make a store with one user and a random password that is kept nowhere.

        Returns
        -------
        tuple
            The store, and the password to show to the user once.
        """
        store, password = cls(), secrets.token_urlsafe(12)
        store.add(name, role, password)
        return store, password

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all users, sorted."""
        return tuple(sorted(self._accounts))

    def account(self, name: str) -> Account | None:
        """Return the stored account, or None if there is no such user."""
        return self._accounts.get(name)

    def add(self, name: str, role: Role, password: str) -> None:
        """Add a user with a password, or replace it.

        Raises
        ------
        ConfigurationError
            if the name is empty or longer than 64 characters, or the password has fewer than 8.
        """
        _check_name(name)
        if len(password) < 8:
            raise ConfigurationError(f"user {name}: a password needs at least 8 characters")
        salt = secrets.token_bytes(16)
        self._accounts[name] = Account(
            name=name,
            role=Role(role),
            salt=base64.b64encode(salt).decode(),
            password_hash=base64.b64encode(_hash(password, salt)).decode(),
        )

    def add_certificate(self, name: str, role: Role, certificate: bytes) -> None:
        """Add a user who shows an X.509 certificate (DER), or replace it."""
        _check_name(name)
        self._accounts[name] = Account(
            name=name, role=Role(role), thumbprint=_thumbprint(certificate)
        )

    def remove(self, name: str) -> None:
        """Remove a user; an unknown one is an error.

        Raises
        ------
        ConfigurationError
            if there is no such user.
        """
        if self._accounts.pop(name, None) is None:
            raise ConfigurationError(f"user {name}: unknown; known are {', '.join(self.names)}")

    def authenticate(self, name: str, password: str, origin: str = "") -> Role | None:
        """Check a password; takes as long for an unknown name as for a known one.

        Parameters
        ----------
        name, password
            What the peer sent.
        origin
            Where it came from (host address), for the lock-out.

        Returns
        -------
        Role or None
            None if the name is unknown, the password wrong or the user locked.
        """
        account = self._accounts.get(name)
        stored = account if account is not None and account.password_hash else None
        salt = base64.b64decode(stored.salt) if stored else _DUMMY_SALT
        cost = (stored.n, stored.r, stored.p) if stored else (_SCRYPT_N, _SCRYPT_R, _SCRYPT_P)
        digest = _hash(password, salt, cost)
        expected = base64.b64decode(stored.password_hash) if stored else bytes(len(digest))
        right = hmac.compare_digest(digest, expected) and stored is not None
        if self.locked(name, origin):
            return None
        if not right or stored is None:
            self._failures_of(name).add(name, origin, self._clock.monotonic())
            return None
        self._failures_of(name).forget(name, origin)
        origins = self._origins.setdefault(name, OrderedDict())
        origins[origin] = None
        origins.move_to_end(origin)
        if len(origins) > _REMEMBERED_ORIGINS:
            origins.popitem(last=False)
        return stored.role

    def knows(self, name: str, origin: str) -> bool:
        """Whether this user has logged in from this address since the start."""
        return origin in self._origins.get(name, ())

    def certificate_role(self, certificate: bytes) -> tuple[str, Role] | None:
        """Return name and role of the user with this certificate (DER), or None."""
        thumbprint = _thumbprint(certificate)
        for account in self._accounts.values():
            if account.thumbprint and hmac.compare_digest(account.thumbprint, thumbprint):
                return account.name, account.role
        return None

    def locked(self, name: str, origin: str = "") -> bool:
        """Whether this name is locked for this peer now.

        Guesses from elsewhere do not lock out an address from which the user has logged in before.
        """
        failures, now = self._failures_of(name), self._clock.monotonic()
        if failures.of_origin(name, origin, now) >= self._allowed_failures:
            return True
        from_anywhere = failures.of_name(name, now) >= 10 * self._allowed_failures
        return from_anywhere and not self.knows(name, origin)

    def unlock(self, name: str) -> None:
        """Forget all wrong passwords for a name."""
        self._failures_of(name).forget_name(name)

    def save(self, file: Path) -> None:
        """Write the users to a JSON file that only its owner can read.

        Raises
        ------
        StorageError
            if the file cannot be written.
        """
        text = json.dumps([asdict(account) for account in self._accounts.values()], indent=2)
        try:
            write_owner_only(file, text.encode() + b"\n")
        except OSError as error:
            raise StorageError(f"{file}: cannot be written: {error.strerror}") from error

    @classmethod
    def load(cls, file: Path, *, clock: Clock | None = None) -> Self:
        """Read the users from a JSON file.

        Raises
        ------
        ConfigurationError
            if the file is missing, not JSON, or a field is wrong: names file and user.
        """
        store = cls(clock=clock)
        try:
            entries = json.loads(file.read_text(encoding="utf-8"))
        except OSError as error:
            raise ConfigurationError(f"{file}: cannot be read: {error.strerror}") from error
        except ValueError as error:
            raise ConfigurationError(f"{file}: not a JSON file of users: {error}") from error
        if not isinstance(entries, list):
            raise ConfigurationError(f"{file}: a list of users is expected")
        for number, entry in enumerate(entries):
            try:
                account = Account(**{**entry, "role": Role(entry["role"])})
                _check_account(account)
            except (TypeError, KeyError, ValueError, ConfigurationError) as error:
                raise ConfigurationError(f"{file}: user {number + 1}: {error}") from error
            store._accounts[account.name] = account
        return store

    def _failures_of(self, name: str) -> Failures:
        """Names that nobody has are counted apart: however many, they flush no user's."""
        known = name in self._accounts
        return self._failures_of_users if known else self._failures_of_strangers


def write_owner_only(file: Path, content: bytes) -> None:
    """Write a file that only its owner can read (POSIX mode 0600), whole or not at all."""
    file.parent.mkdir(parents=True, exist_ok=True)
    draft = file.with_name(f".{file.name}.{secrets.token_hex(4)}")
    descriptor = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(descriptor, "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        draft.replace(file)
    except OSError:
        draft.unlink(missing_ok=True)
        raise


def _hash(
    password: str,
    salt: bytes,
    cost: tuple[int, int, int] = (_SCRYPT_N, _SCRYPT_R, _SCRYPT_P),
) -> bytes:
    n, r, p = cost
    return hashlib.scrypt(
        password.encode("utf-8", "surrogatepass"),
        salt=salt,
        n=n,
        r=r,
        p=p,
        maxmem=_SCRYPT_MEMORY,
        dklen=32,
    )


def _thumbprint(certificate: bytes) -> str:
    return hashlib.sha1(certificate, usedforsecurity=False).hexdigest()


def _check_name(name: str) -> None:
    if not name or len(name) > 64:
        raise ConfigurationError("a user's name needs 1 to 64 characters")


def _check_account(account: Account) -> None:
    _check_name(account.name)
    if account.n > 2**16 or account.n < 2**14 or account.r != 8 or not 1 <= account.p <= 4:
        raise ConfigurationError(f"{account.name}: scrypt cost out of range")
    if not account.thumbprint and not account.password_hash:
        raise ConfigurationError(f"{account.name}: neither password_hash nor thumbprint")
    base64.b64decode(account.salt, validate=True)
    base64.b64decode(account.password_hash, validate=True)
