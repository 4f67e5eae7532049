"""One subscription and its publishing cycle (Part 4, 5.14)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from guarded_opcua.address_space.blocks import Block
from guarded_opcua.binary.encoding import encode_message, ticks_of_ns
from guarded_opcua.clock import Clock, Timer
from guarded_opcua.ledger import Holding
from guarded_opcua.monitoring.block_items import BlockItem, BlockItems
from guarded_opcua.monitoring.data_item import DataItem
from guarded_opcua.monitoring.event_item import EventItem
from guarded_opcua.security.accounts import Role
from guarded_opcua.subscriptions.reports import Reports
from guarded_opcua.subscriptions.sent_messages import RepublishStore, SentMessages

Item = DataItem | EventItem | BlockItem

_LAST_SEQUENCE = 2**32 - 1
_COARSE_S = 0.002  # timers are up to 1 ms late; below this interval, changes trigger publishing


class Owner(Protocol):
    """The session that a subscription publishes to."""

    @property
    def holding(self) -> Holding:
        """Counters of the session's queues."""

    @property
    def subscriptions(self) -> dict[int, "Subscription"]:
        """The subscriptions of the session, by number."""

    def publish(self, subscription: "Subscription") -> None:
        """Send the next message if a publish request is queued, else mark the subscription late."""

    def has_publish_requests(self) -> bool:
        """Return whether a publish request is queued."""

    def lose(self, subscription: "Subscription", code: int | None = None) -> None:
        """Detach a subscription; the client is notified if a code is given."""

    def hears(self, audience: Role) -> bool:
        """Return whether the user may receive events for that role and above."""

    def is_same_client(self, other: object) -> bool:
        """Return whether another session belongs to the same user of the same application."""

    def charge(self, cost: float) -> None:
        """Charge processor time to the session, s."""


@dataclass
class Timing:
    """Revised parameters of a subscription."""

    interval_s: float
    keep_alive_count: int
    lifetime_count: int
    notifications_per_publish: int
    priority: int


@dataclass(frozen=True)
class Message:
    """The content of one publish response."""

    sequence: int
    content: bytes
    available: tuple[int, ...]
    more: bool


class Subscription:
    """Collects the notifications of its items and publishes them in each cycle."""

    def __init__(
        self,
        number: int,
        owner: Owner,
        timing: Timing,
        store: RepublishStore,
        clock: Clock,
        expired: Callable[["Subscription"], None],
        *,
        publishing: bool,
    ) -> None:
        self.number = number
        self.owner = owner
        self.timing = timing
        self.publishing = publishing
        self.items: dict[int, Item] = {}
        self.links = 0  # number of triggering links
        self.waiting_since: float | None = None
        self.sent = SentMessages(store)
        self.clock = clock
        self._expired = expired
        self._reports = Reports()
        self._triggered: set[int] = set()  # items whose linked items are to be reported
        self._linked_by: dict[int, set[int]] = {}
        self._stopped = False
        self._pending: dict[int, DataItem] = {}
        self._sequence = 1
        self._silent_cycles = timing.keep_alive_count  # the first cycle always sends a message
        self._unheard_cycles = 0
        self._last_message: float
        self._next_cycle: float
        self._hurries: bool  # the next cycle is scheduled early
        self._timer: Timer
        self._begin_rhythm()

    @property
    def holding(self) -> Holding:
        """Counters of the owning session's queues."""
        return self.owner.holding

    def give_to(self, owner: Owner) -> None:
        """Move to another session, with all queues."""
        queued = sum(len(item) for item in self.items.values())
        self.owner.holding.add(-queued)
        self.owner = owner
        owner.holding.add(queued)
        self.heard_of()

    def has_report(self, number: int) -> None:
        """Mark an item as having pending notifications."""
        item = self.items[number]
        if not isinstance(item, BlockItem) and not self._stopped:
            self._reports.add(item)
            self.hurry()

    def has_no_report(self, number: int) -> None:
        """Mark an item as having no pending notifications."""
        self._reports.forget(number)

    def hurry(self) -> None:
        """Publish immediately if the interval is short and has passed since the last message."""
        timing = self.timing
        if timing.interval_s > _COARSE_S or self._hurries or self._stopped:
            return
        if self.clock.monotonic() - self._last_message >= timing.interval_s:
            self._hurries = True
            self._timer.cancel()
            self._timer = self.clock.call_at(0.0, self._cycle)  # with all changes until then

    def block_items(self, block: Block) -> BlockItems:
        """Return the block items of this subscription on a block."""
        found = self._reports.blocks.get(block)
        if found is None:
            found = self._reports.blocks[block] = BlockItems(self, block)
            block.watchers.append(found)
        return found

    def has_pending(self, number: int) -> None:
        """Mark an item as holding a value until its sampling time."""
        item = self.items[number]
        if isinstance(item, DataItem):
            self._pending[number] = item

    def trigger(self, number: int) -> None:
        """Report the samples of the items linked to this one with the next message."""
        self._triggered.add(number)
        self.hurry()

    def link(self, item: Item, number: int) -> None:
        """Add a link by which an item triggers another one."""
        self.links += number not in item.links
        item.links.add(number)
        self._linked_by.setdefault(number, set()).add(item.number)

    def unlink(self, item: Item, number: int) -> bool:
        """Remove a triggering link; return whether it existed."""
        if number not in item.links:
            return False
        self.links -= 1
        item.links.discard(number)
        self._linked_by[number].discard(item.number)
        if not self._linked_by[number]:
            del self._linked_by[number]
        return True

    def has_message(self) -> bool:
        """Return whether notifications or a keep-alive are due."""
        if self._triggered:
            self._report_linked()
        if self.publishing and self._reports:
            return True
        return self._silent_cycles >= self.timing.keep_alive_count

    def next_message(self) -> Message:
        """Return the next message: notifications, or a keep-alive if there are none."""
        self._silent_cycles = 0
        self._unheard_cycles = 0
        notifications = self._take_notifications()
        sequence = self._sequence
        content = encode_message(sequence, ticks_of_ns(self.clock.now()), notifications)
        if notifications:
            self._sequence = 1 if sequence == _LAST_SEQUENCE else sequence + 1
            self.sent.keep(sequence, content)
        more = self.publishing and bool(self._reports)
        return Message(sequence, content, self.sent.available, more)

    def heard_of(self) -> None:
        """Restart the lifetime counter: the client is active."""
        self._unheard_cycles = 0

    def republish(self, sequence: int) -> bytes | None:
        """Return an unacknowledged message, None if it is not available."""
        self.heard_of()
        return self.sent.messages.get(sequence)

    def retime(self, timing: Timing) -> None:
        """Set revised parameters and restart the publishing cycle."""
        self.timing = timing
        self.heard_of()
        self._timer.cancel()
        self._begin_rhythm()

    def forget(self, item: Item) -> None:
        """Remove an item with its queue and links."""
        if isinstance(item, BlockItem):
            item.of.remove(item)
        else:
            item.clear()
        for number in list(item.links):
            self.unlink(item, number)
        for number in list(self._linked_by.get(item.number, ())):
            self.unlink(self.items[number], item.number)
        self.items.pop(item.number, None)
        self._reports.forget(item.number)
        self._pending.pop(item.number, None)
        self._triggered.discard(item.number)

    def stop(self) -> None:
        """Stop publishing; the caller then removes the items."""
        self._stopped = True
        self._timer.cancel()
        for block, items in self._reports.blocks.items():
            block.watchers.remove(items)
        self._reports.clear()
        self._pending.clear()
        self._triggered.clear()
        self.sent.clear()

    def _report_linked(self) -> None:
        triggered, self._triggered = self._triggered, set()
        for trigger in triggered:
            for number in self.items[trigger].links:
                if len(self.items[number]):
                    self.has_report(number)

    def _begin_rhythm(self) -> None:
        self._last_message = self.clock.monotonic()
        self._next_cycle = self._last_message + self.timing.interval_s
        self._hurries = False
        self._timer = self.clock.call_at(self._next_cycle, self._cycle)

    def _cycle(self) -> None:
        now = self.clock.monotonic()
        interval = self.timing.interval_s
        if self._hurries:
            self._next_cycle = now
            self._hurries = False
        missed = max(0, int((now - self._next_cycle) / interval))
        self._next_cycle += (missed + 1) * interval
        self._timer = self.clock.call_at(self._next_cycle, self._cycle)
        if self._pending:
            self._pending = {
                number: item for number, item in self._pending.items() if item.sample_pending(now)
            }
        if self.owner.has_publish_requests():
            self._unheard_cycles = 0
        else:
            self._unheard_cycles += 1
            if self._unheard_cycles >= self.timing.lifetime_count:
                self._expired(self)
                return
        if not self.has_message():
            self._silent_cycles += 1
        if self.has_message():
            self._last_message = now
            before = self.clock.processor()
            self.owner.publish(self)
            self.owner.charge(self.clock.processor() - before)

    def _take_notifications(self) -> list[bytes]:
        if not self.publishing or not self._reports:
            return []
        return self._reports.take(self.timing.notifications_per_publish)
