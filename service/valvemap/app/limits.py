"""The operating system's limits on this process, checked before it serves."""

from typing import Final

from valvemap.errors import StorageError

try:
    import resource
except ImportError:  # Windows has no such limits
    resource = None  # type: ignore[assignment]

OWN_DESCRIPTORS: Final = 64  # stores, log, kernels and helpers: 21 are measured at a first start
PER_SOURCE: Final = 2  # a connection, and the next one while it is replaced
ADDRESS_SPACE_MB: Final = 1_000  # a first start of one valve reserves more than 610, at rest
_MB: Final = 2**20


def descriptors_needed(connections: int, sources: int) -> int:
    """Return how many file descriptors a service needs with all its clients.

    >>> descriptors_needed(connections=100, sources=1)
    166
    """
    return OWN_DESCRIPTORS + connections + PER_SOURCE * sources


def allow_descriptors(needed: int) -> None:
    """Raise the soft limit on file descriptors to the hard one, if it is too low.

    Raises
    ------
    StorageError
        if the hard limit is too low, too; it names both numbers.
    """
    if resource is not None:
        hard = _allow(resource.RLIMIT_NOFILE, needed)
        if hard is not None:
            raise StorageError(
                f"{hard} file descriptors are allowed, {needed} are needed; raise the limit "
                "(`ulimit -n`, or LimitNOFILE= of systemd)"
            )


def allow_address_space() -> None:
    """Do the same for this process' address space; call it before numpy and numba are loaded.

    Raises
    ------
    StorageError
        if the hard limit is too low; it names both numbers.
    """
    if resource is not None:
        hard = _allow(resource.RLIMIT_AS, ADDRESS_SPACE_MB * _MB)
        if hard is not None:
            raise StorageError(
                f"{hard // _MB:,} MB of address space are allowed, {ADDRESS_SPACE_MB:,} are "
                "needed; raise the limit (`ulimit -v`, or LimitAS= of systemd)"
            )


def _allow(kind: int, needed: int) -> int | None:
    """Raise a soft limit that is too low; return the hard limit if that is too low, too."""
    soft, hard = resource.getrlimit(kind)
    if _is_enough(soft, needed):
        return None
    if not _is_enough(hard, needed):
        return hard
    resource.setrlimit(kind, (needed if hard < 0 else hard, hard))
    return None


def _is_enough(limit: int, needed: int) -> bool:
    return limit < 0 or limit >= needed  # below 0: no limit
