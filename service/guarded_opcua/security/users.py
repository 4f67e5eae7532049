"""Users of a server: their log-in, lock-out and file."""

import base64
import hmac
import json
import secrets
import sys
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Self

from cryptography import x509
from cryptography.x509.oid import NameOID

from guarded_opcua.clock import Clock, SystemClock
from guarded_opcua.errors import ConfigurationError, StorageError
from guarded_opcua.logs import bounded_logger
from guarded_opcua.security.accounts import Account, Role, check_account, check_name
from guarded_opcua.security.certificate_rules import UNREADABLE, extension
from guarded_opcua.security.certificates import fingerprint, thumbprint
from guarded_opcua.security.lock_out import Failures
from guarded_opcua.security.passwords import DEFAULT_COST, Cost, hash_password
from guarded_opcua.security.whole_files import write_owner_only

_log = bounded_logger(__name__)

_REMEMBERED_STRANGERS = 1_000  # unknown names with failures
_REMEMBERED_ORIGINS = 100  # addresses from which a user has logged in
_DUMMY_SALT = bytes(16)


class UserStore:
    """The users of a server.

    After ``allowed_failures`` wrong passwords for one name from one address, that pair is locked
    for ``lock_seconds``. Ten times as many from all addresses lock the name, except for addresses
    from which the user has logged in before; this limits distributed guessing. While locked, the
    right password is refused, too.

    New passwords are hashed at ``cost``. A file with hashes that are cheaper than the default is
    not loaded, so a lower cost suits only a store that stays in memory, as in tests.

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
        cost: Cost = DEFAULT_COST,
    ) -> None:
        self._cost = cost
        self._accounts: dict[str, Account] = {}
        self._file: Path | None = None
        self._stamp: tuple[int, ...] = ()
        self._failures_of_users = Failures(sys.maxsize, lock_seconds)
        self._failures_of_strangers = Failures(_REMEMBERED_STRANGERS, lock_seconds)
        self._origins: dict[str, OrderedDict[str, None]] = {}  # addresses of successful logins
        self._allowed_failures = allowed_failures
        self._clock = clock or SystemClock()

    @classmethod
    def one_time(cls, name: str, role: Role, cost: Cost = DEFAULT_COST) -> tuple[Self, str]:
        """Create a store with one user and a random password, which is not stored.

        Returns
        -------
        tuple
            The store, and the password to display once.
        """
        store, password = cls(cost=cost), secrets.token_urlsafe(12)
        store.add(name, role, password)
        return store, password

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all users, sorted."""
        return tuple(sorted(self._accounts))

    @property
    def accounts(self) -> Mapping[str, Account]:
        """The stored accounts, by name."""
        return self._accounts

    def add(self, name: str, role: Role, password: str) -> None:
        """Add a user with a password, or replace it.

        Raises
        ------
        ConfigurationError
            if the name is empty or longer than 64 characters, or the password has fewer than 8.
        """
        check_name(name)
        if len(password) < 8:
            raise ConfigurationError(f"user {name}: a password needs at least 8 characters")
        salt = secrets.token_bytes(16)
        self._accounts[name] = Account(
            name=name,
            role=Role(role),
            salt=base64.b64encode(salt).decode(),
            password_hash=base64.b64encode(hash_password(password, salt, self._cost)).decode(),
            **self._cost._asdict(),
        )

    def add_certificate(self, name: str, role: Role, certificate: bytes) -> None:
        """Let a user log in with a certificate (DER); an existing user keeps the password.

        With an authority's certificate, the user logs in with any certificate of that authority for
        the common name ``name``.

        Raises
        ------
        ConfigurationError
            if the name is empty or longer than 64 characters, or the certificate is malformed.
        """
        check_name(name)
        try:
            shown = x509.load_der_x509_certificate(certificate)
            constraints = extension(shown, x509.BasicConstraints)
            usage = extension(shown, x509.KeyUsage)
        except UNREADABLE as error:
            raise ConfigurationError(f"user {name}: not an X.509 certificate") from error
        is_authority = bool(constraints and constraints.ca and usage and usage.key_cert_sign)
        own = fingerprint(certificate)
        self._accounts[name] = replace(
            self._accounts.get(name) or Account(name, role),
            role=Role(role),
            thumbprint="" if is_authority else own,
            authority=own if is_authority else "",
        )

    def remove(self, name: str) -> None:
        """Remove a user.

        Raises
        ------
        ConfigurationError
            if there is no such user.
        """
        if self._accounts.pop(name, None) is None:
            raise ConfigurationError(f"user {name}: unknown; known are {', '.join(self.names)}")

    def authenticate(self, name: str, password: str, origin: str = "") -> Role | None:
        """Check a password, in the same time for unknown and known names.

        Parameters
        ----------
        name, password
            Credentials from the peer.
        origin
            Address of the peer, for the lock-out.

        Returns
        -------
        Role or None
            None if the name is unknown, the password wrong or the user locked.
        """
        account = self._accounts.get(name)
        stored = account if account is not None and account.password_hash else None
        salt = base64.b64decode(stored.salt) if stored else _DUMMY_SALT
        digest = hash_password(password, salt, stored.cost if stored else self._cost)
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
        """Return whether this user has logged in from this address since the start."""
        return origin in self._origins.get(name, ())

    def by_certificate(self, certificate: x509.Certificate) -> Account | None:
        """Return the account of a certificate, by its thumbprint or by its common name."""
        shown = {fingerprint(certificate), thumbprint(certificate)}
        for account in self._accounts.values():
            if not account.anchors.isdisjoint(shown):
                return account
        names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
        named = self._accounts.get(str(names[0].value)) if len(names) == 1 else None
        return named if named is not None and named.authority else None

    def locked(self, name: str, origin: str = "") -> bool:
        """Return whether this name is locked for this address now.

        Failures from other addresses do not lock an address from which the user has logged in
        before.
        """
        failures, now = self._failures_of(name), self._clock.monotonic()
        if failures.of_origin(name, origin, now) >= self._allowed_failures:
            return True
        from_anywhere = failures.of_name(name, now) >= 10 * self._allowed_failures
        return from_anywhere and not self.knows(name, origin)

    def unlock(self, name: str) -> None:
        """Reset the lock-out of a name."""
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
            if the file is missing, not JSON, or a field is wrong; the message names file and user.
        """
        store = cls(clock=clock)
        store._file = file
        store._read(file)
        return store

    def refresh(self) -> bool:
        """Reload the file if it has changed; return whether the users have changed.

        If the file cannot be read, the users are kept and a warning is logged.
        """
        if self._file is None or _stamp(self._file) == self._stamp:
            return False
        before = self._accounts
        try:
            self._read(self._file)
        except ConfigurationError as error:
            _log.warning("%s; the users stay as they were", error)
        return self._accounts != before

    def _read(self, file: Path) -> None:
        self._stamp = _stamp(file)
        accounts: dict[str, Account] = {}
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
                check_account(account)
            except (TypeError, KeyError, ValueError, ConfigurationError) as error:
                raise ConfigurationError(f"{file}: user {number + 1}: {error}") from error
            accounts[account.name] = account
        self._accounts = accounts

    def _failures_of(self, name: str) -> Failures:
        """Return the counters of a name; unknown names have their own, so they evict no user's."""
        known = name in self._accounts
        return self._failures_of_users if known else self._failures_of_strangers


def _stamp(file: Path) -> tuple[int, ...]:
    try:
        held = file.stat()
    except OSError:
        return ()
    return held.st_mtime_ns, held.st_ctime_ns, held.st_size, held.st_ino
