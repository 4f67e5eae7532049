"""Accounts of users: role, stored password and certificate; their checks."""

import base64
import re
from dataclasses import dataclass, fields
from enum import IntEnum

from guarded_opcua.errors import ConfigurationError
from guarded_opcua.security.passwords import DEFAULT_COST, LEAST_N, Cost

_HEX = re.compile("([0-9a-f]{40}|[0-9a-f]{64})?")


class Role(IntEnum):
    """Permissions of a user; a higher role includes the lower ones.

    >>> Role.OPERATOR >= Role.OBSERVER
    True
    """

    OBSERVER = 1
    OPERATOR = 2
    ENGINEER = 3
    SECURITY_ADMIN = 4


@dataclass(frozen=True)
class Account:
    """A stored user with a salted scrypt hash of the password, a certificate, or both.

    ``password_hash`` and ``salt`` are base64. ``thumbprint`` is the SHA-256 of the user's
    certificate in hex, or its SHA-1 if an earlier version stored it. ``authority`` is the SHA-256
    of an authority that certifies the user under the common name ``name``. At least one of them is
    not empty.
    """

    name: str
    role: Role
    salt: str = ""
    password_hash: str = ""
    thumbprint: str = ""
    authority: str = ""
    n: int = DEFAULT_COST.n
    r: int = DEFAULT_COST.r
    p: int = DEFAULT_COST.p

    @property
    def anchors(self) -> frozenset[str]:
        """Thumbprints of the user's certificate and of its authority."""
        return frozenset({self.thumbprint, self.authority} - {""})

    @property
    def cost(self) -> Cost:
        """Cost of the password's hash."""
        return Cost(self.n, self.r, self.p)


def check_name(name: str) -> None:
    """Raise ConfigurationError unless a name has 1 to 64 characters."""
    if not name or len(name) > 64:
        raise ConfigurationError("a user's name needs 1 to 64 characters")


def check_account(account: Account) -> None:
    """Raise ConfigurationError or ValueError if a stored account is malformed."""
    for given in fields(account):
        value, kind = getattr(account, given.name), type(given.default)
        if given.name != "role" and type(value) is not (str if given.name == "name" else kind):
            raise ConfigurationError(f"{given.name} is {str(value)[:40]!r}, of the wrong type")
    check_name(account.name)
    if not LEAST_N <= account.n <= 2**16 or account.r != 8 or not 1 <= account.p <= 4:
        raise ConfigurationError(f"{account.name}: scrypt cost out of range")
    if not (account.thumbprint or account.authority or account.password_hash):
        raise ConfigurationError(f"{account.name}: neither password_hash nor thumbprint")
    if not _HEX.fullmatch(account.thumbprint) or not _HEX.fullmatch(account.authority):
        raise ConfigurationError(f"{account.name}: a thumbprint has 40 or 64 digits 0-9, a-f")
    base64.b64decode(account.salt, validate=True)
    base64.b64decode(account.password_hash, validate=True)
