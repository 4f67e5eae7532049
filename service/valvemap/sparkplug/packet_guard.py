"""Limits on a broker's packets, checked by the fixed header before the body is received. Pure.

In MQTT 3.1.1, a client cannot announce a maximum packet size, so this module enforces one.
"""

from collections.abc import Iterator
from typing import Final

from valvemap.errors import SinkLost

LARGEST_PACKET: Final = 1_048_576  # bytes; a rebirth request or a STATE message has some 100
MOST_UNREAD: Final = 1_000  # answers the broker has not read; paho keeps some 300 bytes of each
_LENGTH_BYTES: Final = 4  # of the remaining length, MQTT 3.1.1, 2.2.3
_PUBLISH, _PUBACK, _PINGREQ, _PINGRESP = 3, 4, 12, 13  # packet types, MQTT 3.1.1, 2.2.1


class PacketRefused(SinkLost):
    """The broker sent a packet beyond the limits; the connection is closed, then retried."""


class PacketHeaders:
    """Incremental parser of the fixed headers in one direction of a connection.

    Examples
    --------
    >>> headers = PacketHeaders()
    >>> list(headers.feed(bytes([0x30, 0x80]))), list(headers.feed(bytes([0x01, 0x00])))
    ([], [(48, 128)])
    """

    def __init__(self) -> None:
        self._first: int | None = None  # first byte of the header being parsed
        self._length, self._digits = 0, 0
        self._body = 0  # bytes remaining of the current packet's body

    def feed(self, data: bytes) -> Iterator[tuple[int, int]]:
        """Yield first byte and remaining length of every header that ends in these bytes.

        Raises
        ------
        ValueError
            if a remaining length has more than four bytes.
        """
        at = 0
        while at < len(data):
            if self._body:
                skipped = min(self._body, len(data) - at)
                self._body -= skipped
                at += skipped
            elif self._first is None:
                self._first, self._length, self._digits = data[at], 0, 0
                at += 1
            else:
                self._length |= (data[at] & 0x7F) << (7 * self._digits)
                self._digits += 1
                is_last = not data[at] & 0x80
                at += 1
                if is_last:
                    found, self._first, self._body = self._first, None, self._length
                    yield found, self._length
                elif self._digits == _LENGTH_BYTES:
                    raise ValueError("a remaining length of more than four bytes")


class PacketGuard:
    """Checks the packets of one connection.

    It refuses packets larger than ``largest``; a PUBLISH of QoS 2, which no subscription grants and
    which the client would have to keep until its release; and a broker that requests answers but
    leaves ``most_unread`` of them unread.

    Attributes
    ----------
    refusal : PacketRefused or None
        Reason to close the connection.
    received : int
        Number of packet headers received.
    """

    def __init__(
        self, url: str, largest: int = LARGEST_PACKET, most_unread: int = MOST_UNREAD
    ) -> None:
        self.refusal: PacketRefused | None = None
        self.received = 0
        self._url, self._largest, self._most_unread = url, largest, most_unread
        self._incoming, self._outgoing = PacketHeaders(), PacketHeaders()
        self._unread = 0

    def receive(self, data: bytes) -> None:
        """Check received bytes.

        Raises
        ------
        PacketRefused
        """
        if self.refusal is not None:
            raise self.refusal
        try:
            for first, length in self._incoming.feed(data):
                self.received += 1
                self._judge(first, length)
        except ValueError as error:
            self._refuse(f"it sent {error}")

    def send(self, data: bytes) -> None:
        """Count the answers among bytes sent to the broker."""
        for first, _ in self._outgoing.feed(data):
            self._unread -= first >> 4 in {_PUBACK, _PINGRESP}

    def _judge(self, first: int, length: int) -> None:
        kind, qos = first >> 4, first >> 1 & 3
        if length > self._largest:
            self._refuse(f"it sent a packet of {length} bytes; {self._largest} are allowed")
        if kind == _PUBLISH and qos > 1:
            self._refuse(f"it sent a message of QoS {qos}; 0 and 1 are allowed")
        self._unread += kind == _PINGREQ or (kind == _PUBLISH and qos == 1)
        if self._unread > self._most_unread:
            self._refuse(f"it read none of {self._most_unread} answers")

    def _refuse(self, reason: str) -> None:
        self.refusal = PacketRefused(f"{self._url}: connection closed: {reason}")
        raise self.refusal
