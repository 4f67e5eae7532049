"""What a monitored item is asked to do, and what it knows of its subscription (Part 4, 5.13)."""

from dataclasses import dataclass
from typing import Protocol

from asyncua import ua

from guarded_opcua.ledger import Holding
from guarded_opcua.monitoring.data_change import ChangeRule

OVERFLOW = 0x0480  # InfoType DataValue, Overflow (Part 4, 7.39.1)

Queued = tuple[int, ua.DataValue]  # number of the change, and the value


@dataclass
class Monitoring:
    """What a client may modify: the parameters of an item, as revised."""

    client_handle: int
    rule: ChangeRule
    queue_size: int
    discard_oldest: bool
    interval_s: float  # 0: every change
    stamps: ua.TimestampsToReturn


class Reporter(Protocol):
    """The subscription of an item, as far as its items know it."""

    @property
    def holding(self) -> Holding:
        """What the queues of the session hold."""

    def time(self) -> float:
        """Seconds that never run back."""

    def has_report(self, number: int) -> None:
        """Note that an item has something to report."""

    def has_no_report(self, number: int) -> None:
        """Note that an item has nothing to report any more."""

    def has_pending(self, number: int) -> None:
        """Note that an item holds a value back until its sampling time."""

    def hurry(self) -> None:
        """Publish at once if the rhythm is a fast one and a whole interval has passed."""

    def trigger(self, number: int) -> None:
        """Report what the items linked to this one have sampled, when the next message is made."""
