"""Parameters of a monitored item, and its interface to the subscription (Part 4, 5.13)."""

from dataclasses import dataclass
from typing import Protocol

from asyncua import ua

from guarded_opcua.clock import Clock
from guarded_opcua.ledger import Holding
from guarded_opcua.monitoring.data_change import ChangeRule

OVERFLOW = 0x0480  # InfoType DataValue, Overflow (Part 4, 7.39.1)

Queued = tuple[int, ua.DataValue]  # moment of the change, value


@dataclass
class Monitoring:
    """Revised parameters of a data item."""

    client_handle: int
    rule: ChangeRule
    queue_size: int
    discard_oldest: bool
    interval_s: float  # 0: every change
    stamps: ua.TimestampsToReturn


class Reporter(Protocol):
    """The subscription of an item, as its items use it."""

    @property
    def holding(self) -> Holding:
        """Counters of the session's queues."""

    @property
    def clock(self) -> Clock:
        """The server's clock."""

    def has_report(self, number: int) -> None:
        """Mark an item as having pending notifications."""

    def has_no_report(self, number: int) -> None:
        """Mark an item as having no pending notifications."""

    def has_pending(self, number: int) -> None:
        """Mark an item as holding a value until its sampling time."""

    def hurry(self) -> None:
        """Publish immediately if the interval is short and has passed since the last message."""

    def trigger(self, number: int) -> None:
        """Report the samples of the items linked to this one with the next message."""
