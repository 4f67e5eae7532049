"""When a subscription publishes, on a clock turned by hand."""

from itertools import pairwise

import pytest
from asyncua import ua

from guarded_opcua.binary.encoding import instant
from guarded_opcua.clock import ManualClock
from guarded_opcua.ledger import Holding, Ledger
from guarded_opcua.monitoring.data_change import ChangeRule
from guarded_opcua.monitoring.data_item import DataItem
from guarded_opcua.monitoring.parameters import Monitoring
from guarded_opcua.subscriptions.sent_messages import RepublishStore
from guarded_opcua.subscriptions.subscription import Subscription, Timing


class Owner:
    """A session whose client always asks; notes when it was sent something."""

    def __init__(self, clock):
        self.holding = Holding(Ledger(1_000))
        self.times = []
        self._clock = clock

    def charge(self, cost):
        pass

    def has_publish_requests(self):
        return True

    def publish(self, subscription):
        while subscription.has_message():
            subscription.next_message()
            self.times.append(self._clock.monotonic())
        return True


class Bench:
    """A subscription with one item."""

    def __init__(self, interval_s):
        self.clock = ManualClock()
        self.owner = Owner(self.clock)
        timing = Timing(interval_s, 100, 1_000, 100, 0)
        self.subscription = Subscription(
            1, self.owner, timing, RepublishStore(10, 10**6), self.clock, print, publishing=True
        )
        monitoring = Monitoring(7, ChangeRule(), 10, discard_oldest=True, interval_s=0.0, stamps=2)
        wanted = ua.ReadValueId(NodeId=ua.NodeId(1), AttributeId=ua.AttributeIds.Value)
        reporting = ua.MonitoringMode.Reporting
        self.item = DataItem(self.subscription, 1, wanted, reporting, monitoring, None)
        self.subscription.items[1] = self.item
        self.clock.advance(interval_s)  # the first message of a subscription
        self.owner.times.clear()

    def change(self, number):
        variant = ua.Variant(float(number), ua.VariantType.Double)
        self.item(0, ua.DataValue(variant, ua.StatusCode(0), instant(0), instant(0)))


def test_a_subscription_publishes_in_its_rhythm():
    bench = Bench(0.5)
    bench.clock.advance(1.25)
    bench.change(1)
    bench.clock.advance(0.2)
    assert bench.owner.times == []
    bench.clock.advance(0.2)
    assert bench.owner.times == [pytest.approx(2.0)]


def test_a_rhythm_finer_than_timers_follows_the_changes():
    bench = Bench(0.001)
    bench.clock.advance(0.0105)
    bench.change(1)
    bench.change(2)
    bench.clock.advance(0.0)
    assert bench.owner.times == [pytest.approx(0.0115)]


def test_a_fast_rhythm_leaves_its_interval_between_two_messages():
    bench = Bench(0.001)
    for k in range(100):
        bench.change(k)
        bench.clock.advance(0.0003)
    times = bench.owner.times
    assert len(times) >= 20
    assert min(b - a for a, b in pairwise(times)) >= 0.001 - 1e-9
    assert not len(bench.item) or bench.clock.monotonic() - times[-1] < 0.001
