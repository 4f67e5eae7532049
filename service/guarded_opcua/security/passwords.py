"""Passwords as salted scrypt hashes (RFC 7914)."""

import hashlib
from typing import Final, NamedTuple

LEAST_N: Final = 2**14  # of a stored hash: 16 MB and about 40 ms per guess
_MEMORY: Final = 64 * 1024 * 1024


class Cost(NamedTuple):
    """Work of one hash: ``p`` times ``n`` rounds, in 128·n·r bytes of memory."""

    n: int = LEAST_N
    r: int = 8
    p: int = 1


DEFAULT_COST: Final = Cost()


def hash_password(password: str, salt: bytes, cost: Cost) -> bytes:
    """Return the scrypt hash of a password, 32 bytes."""
    return hashlib.scrypt(
        password.encode("utf-8", "surrogatepass"),
        salt=salt,
        n=cost.n,
        r=cost.r,
        p=cost.p,
        maxmem=_MEMORY,
        dklen=32,
    )
