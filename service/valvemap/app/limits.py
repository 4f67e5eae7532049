"""The operating system's limits on this process, checked before it serves."""

from typing import Final

from valvemap.errors import StorageError

try:
    import resource
except ImportError:  # Windows has no such limits
    resource = None  # type: ignore[assignment]

OWN_DESCRIPTORS: Final = 64  # stores, log, kernels and helpers: 21 are measured at a first start
PER_SOURCE: Final = 2  # a connection, and the next one while it is replaced


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
    if resource is None:
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if _is_enough(soft, needed):
        return
    if not _is_enough(hard, needed):
        raise StorageError(
            f"{hard} file descriptors are allowed, {needed} are needed; raise the limit "
            "(`ulimit -n`, or LimitNOFILE= of systemd)"
        )
    resource.setrlimit(resource.RLIMIT_NOFILE, (needed if hard < 0 else hard, hard))


def _is_enough(limit: int, needed: int) -> bool:
    return limit < 0 or limit >= needed  # below 0: no limit
