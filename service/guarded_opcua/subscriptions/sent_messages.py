"""Messages of a subscription that the client has not acknowledged (Part 4, 5.14.1)."""

from collections import OrderedDict
from dataclasses import dataclass

from asyncua import ua


@dataclass
class RepublishStore:
    """Capacity for unacknowledged messages, shared by all subscriptions."""

    messages: int
    capacity: int
    held: int = 0


class SentMessages:
    """The unacknowledged messages of one subscription; the oldest are dropped beyond capacity."""

    def __init__(self, store: RepublishStore) -> None:
        self._store = store
        self.messages: OrderedDict[int, bytes] = OrderedDict()  # by sequence number

    @property
    def available(self) -> tuple[int, ...]:
        """Sequence numbers that are available for Republish."""
        return tuple(self.messages)

    def keep(self, sequence: int, content: bytes) -> None:
        """Keep a message until it is acknowledged; drop the oldest ones beyond capacity."""
        self.messages[sequence] = content
        self._store.held += len(content)
        while len(self.messages) > self._store.messages or (
            self._store.held > self._store.capacity and len(self.messages) > 1
        ):
            _, dropped = self.messages.popitem(last=False)
            self._store.held -= len(dropped)

    def acknowledge(self, sequence: int) -> int:
        """Drop an acknowledged message; return a status code."""
        content = self.messages.pop(sequence, None)
        if content is None:
            return ua.StatusCodes.BadSequenceNumberUnknown
        self._store.held -= len(content)
        return ua.StatusCodes.Good

    def clear(self) -> None:
        """Drop all messages."""
        self._store.held -= sum(map(len, self.messages.values()))
        self.messages.clear()
