"""Admission to a bounded number of places, shared fairly between addresses; it does no I/O."""

import ipaddress
from collections import Counter
from collections.abc import Callable, Container, Hashable, Iterator
from typing import Any, Generic, Protocol, TypeVar

Holder = TypeVar("Holder", bound=Hashable)


class Monotonic(Protocol):
    """A monotonic clock."""

    def monotonic(self) -> float:
        """Return the monotonic time, s."""


class Admission(Generic[Holder]):
    """Admits holders of places; if all places are taken, it evicts another holder if possible.

    The evicted holder is the one of the lowest rank at the address with the most places.

    Parameters
    ----------
    clock
        Clock of the admission rate.
    most, most_of_address
        Number of places, in total and per address.
    per_second
        Admission attempts of one address that are considered in one second.
    rank
        Returns a holder's rank; holders with the lowest rank are evicted first.
    staying
        Returns the holders that a newcomer cannot evict.
    give_way
        Called with the evicted holder.

    Examples
    --------
    >>> from guarded_opcua.clock import ManualClock
    >>> admission = Admission(ManualClock(), 3, 2, 10, len, lambda newcomer: (), print)
    >>> [admission.admit(name, "10.0.0.1") for name in ("anna", "bert")]
    [True, True]
    >>> admission.admit("charly", "10.0.0.1")
    anna
    True
    >>> [admission.admit(name, "10.0.0.2") for name in ("d", "e")]
    bert
    [True, True]
    """

    def __init__(
        self,
        clock: Monotonic,
        most: int,
        most_of_address: int,
        per_second: int,
        rank: Callable[[Holder], Any],
        staying: Callable[[Holder], Container[Holder]],
        give_way: Callable[[Holder], object],
    ) -> None:
        self._clock = clock
        self._most, self._most_of_address, self._per_second = most, most_of_address, per_second
        self._rank, self._staying, self._give_way = rank, staying, give_way
        self._holders: dict[Holder, str] = {}
        self._of_address: Counter[str] = Counter()
        self._asked: Counter[str] = Counter()  # in this second
        self._second = 0

    def __iter__(self) -> Iterator[Holder]:
        return iter(tuple(self._holders))

    def __len__(self) -> int:
        return len(self._holders)

    def __contains__(self, holder: object) -> bool:
        return holder in self._holders

    def held_at(self, host: str) -> int:
        """Return the number of places that the address of a host holds."""
        return self._of_address[address_of(host)]

    def admit(self, newcomer: Holder, host: str) -> bool:
        """Return whether a newcomer from a host is admitted, evicting another holder if needed."""
        address = address_of(host)
        if not self._is_slow_enough(address):
            return False
        if self._of_address[address] >= self._most_of_address and not self._make_room(
            newcomer, {address}
        ):
            return False
        if len(self._holders) >= self._most and not self._make_room(newcomer, self._of_address):
            return False
        self._holders[newcomer] = address
        self._of_address[address] += 1
        return True

    def leave(self, holder: Holder) -> bool:
        """Free the place of a holder; return whether it had one."""
        address = self._holders.pop(holder, None)
        if address is None:
            return False
        self._of_address[address] -= 1
        if not self._of_address[address]:
            del self._of_address[address]
        return True

    def _is_slow_enough(self, address: str) -> bool:
        second = int(self._clock.monotonic())
        if second != self._second:
            self._second = second
            self._asked.clear()
        self._asked[address] += 1
        return self._asked[address] <= self._per_second

    def _make_room(self, newcomer: Holder, addresses: Container[str]) -> bool:
        staying = self._staying(newcomer)
        others = [
            (-self._of_address[address], self._rank(holder), number, holder)
            for number, (holder, address) in enumerate(self._holders.items())
            if address in addresses and holder not in staying
        ]
        if not others:
            return False
        *_, victim = min(others)
        self.leave(victim)
        self._give_way(victim)
        return True


def address_of(host: str) -> str:
    """Return the address by which a host is counted: the /64 network of an IPv6 host.

    >>> address_of("2001:db8::1") == address_of("2001:db8::ffff:2"), address_of("::ffff:10.0.0.1")
    (True, '10.0.0.1')
    >>> address_of("10.0.0.1"), address_of("?")
    ('10.0.0.1', '?')
    """
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return host
    if isinstance(address, ipaddress.IPv4Address):
        return str(address)
    if address.ipv4_mapped is not None:
        return str(address.ipv4_mapped)
    return str(ipaddress.ip_network((int(address), 64), strict=False))
